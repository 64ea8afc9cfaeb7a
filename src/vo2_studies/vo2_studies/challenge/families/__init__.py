"""Families of concealed hysteresis: each draws a film; what they share is the protocol in `law`.

`plays` and `clusters` are independent domains, `interacting` domains in the mean field, `proximity` the limiting-loop
proximity model, `jiles_atherton` a differential law with rate-dependent coercivity, `duhem` one whose only memory is
its fraction, `bouc_wen` one whose transition lags behind the temperature, `accommodating` domains that mix as they
switch, `avalanches` grains that help their neighbours over.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from vo2_studies.challenge.families import (
    accommodating,
    avalanches,
    bouc_wen,
    domains,
    duhem,
    interacting,
    jiles_atherton,
    proximity,
)
from vo2_studies.challenge.families.law import Film, Statistics, major_loop

__all__ = ["ALL", "FAMILIES", "Film", "Statistics", "chosen_families", "draw_film", "major_loop"]

Draw = Callable[[np.random.Generator, Statistics, float], Film]
FAMILIES: dict[str, Draw] = {
    "plays": partial(domains.draw, kind="plays"),
    "clusters": partial(domains.draw, kind="clusters"),
    "interacting": interacting.draw,
    "proximity": proximity.draw,
    "jiles_atherton": jiles_atherton.draw,
    "duhem": duhem.draw,
    "bouc_wen": bouc_wen.draw,
    "accommodating": accommodating.draw,
    "avalanches": avalanches.draw,
}
ALL = "all"


def chosen_families(family: str, leave_out: str = "") -> tuple[str, ...]:
    """Return the families that `family` ("all" or a name) means, without `leave_out`.

    Raises
    ------
    ValueError : unknown names, or nothing left.
    """
    for option, name in (("family", family), ("leave-out", leave_out or ALL)):
        if name != ALL and name not in FAMILIES:
            raise ValueError(f"{option}: found {name!r}, need {ALL} or one of {', '.join(FAMILIES)}")
    names = tuple(name for name in FAMILIES if family in (ALL, name) and name != leave_out)
    if not names:
        raise ValueError(f"leave-out: found {leave_out!r}, which is the only family asked for; need another")
    return names


def draw_film(rng: np.random.Generator, film: Statistics, *, misfit: float, family: str) -> Film:
    """Draw a film of `family` with the given statistics.

    Parameters
    ----------
    misfit : relative scatter from part to part of what the family has as its shape [1], 0 to 0.3

    Raises
    ------
    ValueError : misfit outside 0 to 0.3, unknown family.
    """
    if not 0 <= misfit <= 0.3:
        raise ValueError(f"misfit: found {misfit}, need 0 to 0.3")
    if family not in FAMILIES:
        raise ValueError(f"family: found {family!r}, need one of {', '.join(FAMILIES)}")
    return FAMILIES[family](rng, film, misfit)
