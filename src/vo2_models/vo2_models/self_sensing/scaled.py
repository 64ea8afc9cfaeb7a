"""The input of the direct schemes: -log10 of the resistance on the scale of a film temperature.

A direct scheme takes the resistance itself for the input of a hysteresis model. Mapped onto 30 to 90 (the
coldest to the hottest end, in degC by order of magnitude), it goes through the same fit as a temperature.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vo2_models.numerics.kernel import kernel

__all__ = ["COLD", "HOT", "domain_of", "scaled", "scaled_one"]

Floats = NDArray[np.float64]

COLD, HOT = 30.0, 90.0


def domain_of(log_resistance: Floats) -> Floats:
    """Return (2,): lowest and highest log10 R; raise `ValueError` where it does not change.

    Parameters
    ----------
    log_resistance : (n,) log10 of the resistance [ohm]
    """
    domain = np.array([log_resistance.min(), log_resistance.max()])
    if not domain[1] > domain[0]:
        raise ValueError("resistance: found one value throughout, need a recording in which it changes")
    return domain


def scaled(log_resistance: Floats, domain: Floats) -> Floats:
    """Map log10 R (n,) onto COLD (highest) to HOT (lowest); beyond them it goes on linearly.

    Parameters
    ----------
    log_resistance : (n,) log10 of the resistance [ohm]
    domain : (2,) lowest and highest log10 R

    Returns
    -------
    array : (n,)
    """
    return COLD + (HOT - COLD) * (domain[1] - log_resistance) / (domain[1] - domain[0])


@kernel
def scaled_one(resistance, domain):
    """`scaled` of one resistance [ohm].

    Parameters
    ----------
    resistance : [ohm]
    domain : (2,) lowest and highest log10 R

    Returns
    -------
    float : as an element of `scaled`
    """
    return COLD + (HOT - COLD) * (domain[1] - math.log10(resistance)) / (domain[1] - domain[0])
