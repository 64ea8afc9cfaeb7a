"""How an effect's amplitude departs from a straight line in time, over each recording."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.identification.enrichment import cubic_spline

__all__ = ["Bend", "walks_of"]

Floats = NDArray[np.float64]


def walks_of(count: int, size: int, start: float = 1.0) -> Floats:
    """Return (size, count) random walks from one cubic spline of a recording to the next, each a step by 1.

    Parameters
    ----------
    count : of splines
    size : samples of the recording
    start : what the first of them is, which is one constant throughout
    """
    knots = np.asarray((np.arange(count) - 1.0) / (count - 3.0), dtype=np.float64)
    past = (np.arange(size) + 1.0) / size
    steps = np.tril(np.ones((count, count)))
    steps[:, 0] = start
    return np.asarray(cubic_spline(knots, past) @ steps)


@dataclass(frozen=True)
class Bend:
    """Amplitude f(t) = rate (T sum_k w_pk walk_k(t) - line t) in recording p, T its length; the line is common to all.

    Attributes
    ----------
    rate : by which a walk of weight 1 steps over a recording, in the unit of the effect's amplitude a second
    shares : (p, c) of each walk, what the straight line has of it
    start : amplitude of the first walk of each recording, a constant, in those steps
    weights : (p, c); empty where everything is linear about the straight line
    line : sum of each share times its weight
    """

    rate: float
    shares: Floats
    start: float = 1.0
    weights: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    line: float = 0.0

    def by(self, weights: Floats) -> Bend:
        """Return the same with other weights, (p, c) or (p c,)."""
        own = np.reshape(weights, self.shares.shape)
        return replace(self, weights=own, line=float(np.sum(self.shares * own)))

    def raised(self, by: float) -> Bend:
        """Return the same with the first walk of each recording, the constant, larger by a weight."""
        weights = self.weights.copy()
        weights[:, 0] += by
        return self.by(weights)

    def amplitude(self, place: int, size: int, length: float) -> Floats:
        """Return f at the samples (size,) of a recording of a length [s], by its place; 0 without weights."""
        if not self.weights.size:
            return np.zeros(size)
        past = (np.arange(size) + 1.0) / size
        walks = walks_of(self.weights.shape[1], size, self.start) @ self.weights[place]
        return np.asarray(self.rate * length * (walks - past * self.line))
