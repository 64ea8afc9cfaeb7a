"""Whether probabilities mean what they say: of effects stated with probability p, a share p should be true."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vo2_studies.challenge.figures import interval
from vo2_studies.challenge.judging import Judgement

__all__ = ["EDGES", "reliability"]

EDGES = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
"""Bins of stated probability: finer where diagnoses state most."""

WITHIN = 0.05
"""Largest wanted distance of the observed share from the stated probability."""


def reliability(judgements: Sequence[Judgement]) -> list[dict[str, Any]]:
    """Return the bins that have entries.

    Each has from, to, count, mean stated probability, observed share and its interval, and whether they are within `WITHIN`.
    """
    pairs = np.array([pair for j in judgements for pair in j.stated], dtype=float).reshape(-1, 2)
    place = np.clip(np.searchsorted(EDGES, pairs[:, 0], side="right") - 1, 0, len(EDGES) - 2)
    bins = []
    for k in np.unique(place):
        stated, true = pairs[place == k].T
        bins.append(
            {
                "from": EDGES[k],
                "to": EDGES[k + 1],
                "count": int(true.size),
                "stated": float(stated.mean()),
                "observed": float(true.mean()),
                "interval": list(interval(int(true.sum()), int(true.size))),
                "met": bool(abs(stated.mean() - true.mean()) <= WITHIN),
            }
        )
    return bins
