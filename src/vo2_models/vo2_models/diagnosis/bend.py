"""How an effect's amplitude departs from a straight line in time, over one recording."""

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
    """Amplitude f(t) = unit sum_k w_k (walk_k(t) - share_k t / T), T the length of the recording.

    Attributes
    ----------
    unit : amplitude of a walk of weight 1, in the unit of the effect's amplitude
    shares : (c,) of each walk, what the straight line has of it
    start : amplitude of the first walk, a constant, in `unit`
    weights : (c,); empty where everything is linear about the straight line
    """

    unit: float
    shares: Floats
    start: float = 1.0
    weights: Floats = field(default_factory=lambda: np.zeros(0))

    def raised(self, by: float) -> Bend:
        """Return the same with its first walk, the constant, larger by a weight."""
        return replace(self, weights=np.concatenate([self.weights[:1] + by, self.weights[1:]]))

    def amplitude(self, size: int) -> Floats:
        """Return f at the samples (size,) of the recording, 0 without weights."""
        if not self.weights.size:
            return np.zeros(size)
        past = (np.arange(size) + 1.0) / size
        walks = walks_of(self.weights.size, size, self.start)
        return np.asarray(self.unit * (walks @ self.weights - past * float(self.shares @ self.weights)))
