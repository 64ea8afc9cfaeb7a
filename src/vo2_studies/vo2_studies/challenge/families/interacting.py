"""Interacting domains in the mean field: every grain's thresholds move with the transformed fraction of the whole film.

The moving model, Della Torre, IEEE Trans. Audio Electroacoust. 14, 86, 1966: grains see T + kappa (s - 1/2), kappa > 0
for strain that helps neighbours over, < 0 for strain that holds them back. The thresholds are moved the other way along
both branches, so that the major loop stays what was drawn and minor loops alone (no longer congruent) tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_studies.challenge.families.domains import draw_grains
from vo2_studies.challenge.families.law import Film, Statistics
from vo2_studies.challenge.families.relays import relays

__all__ = ["draw"]

Array = NDArray[np.floating]
NARROWEST = 0.2
"""Smallest width of a grain's loop [K]; a relay's thresholds are ordered."""


def draw(rng: np.random.Generator, film: Statistics, misfit: float) -> Film:
    """Draw a film of grain clusters that interact by 0.6 to 2.5 K, either sign."""
    grains = draw_grains(rng, film, misfit, "clusters")
    feedback = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.6), np.log(2.5))))
    laws = []
    for up, down in ((grains.up_metal, grains.down_metal), (grains.up_structure, grains.down_structure)):
        rising, falling = (x + feedback * (_rank(x, grains.weight) - 0.5) for x in (up, down))
        middle, width = (rising + falling) / 2, np.maximum(rising - falling, NARROWEST)
        laws.append(relays(middle + width / 2, middle - width / 2, grains.weight))
    return Film(laws[0], laws[1], feedback)


def _rank(thresholds: Array, weight: Array) -> Array:
    """Return the share of material with a lower threshold (n,)."""
    order = np.argsort(thresholds, kind="stable")
    rank = np.empty(thresholds.size)
    rank[order] = np.cumsum(weight[order]) - weight[order] / 2
    return rank
