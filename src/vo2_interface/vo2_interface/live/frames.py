"""What the page is sent: the samples since the last frame, joined by their stamps."""

from __future__ import annotations

import json
import math
import threading
from collections import deque

from vo2_interface.live.simulated import Expected

__all__ = ["CHANNELS", "Frames", "TurningPoints"]

CHANNELS = (
    *("current", "resistance", "measured", "estimate", "bound", "reference"),
    *("simulated_resistance", "simulated", "differs"),
)
"""Columns of a sample behind its time, as the page takes them: A, ohm, then m; of the simulation ohm, m, and 1 or 0."""
_NAN = float("nan")
_KEPT = 6000
"""Samples kept for a page that is slow or has just been opened."""


class TurningPoints:
    """Where a path has turned, without what later, larger turns have wiped out: what a hysteresis remembers of it.

    Parameters
    ----------
    least : turns smaller than this are none; noise would be full of them

    Attributes
    ----------
    points : value at each turn and what was given with it, the oldest and largest first
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._sign = 1.0
        self._farthest: tuple[float, tuple[float, ...]] | None = None
        self.points: list[tuple[float, tuple[float, ...]]] = []

    def follow(self, value: float, place: tuple[float, ...]) -> None:
        """Take the next value of the path, and what belongs to it; what is no number is passed over."""
        if not math.isfinite(value):
            return
        if self._farthest is None or self._sign * (value - self._farthest[0]) >= 0.0:
            self._farthest = (value, place)
        elif self._sign * (self._farthest[0] - value) > self._least:
            self.points.append(self._farthest)
            self._sign, self._farthest = -self._sign, (value, place)
        # beyond the turn before the last one both are forgotten
        while len(self.points) > 1 and self._sign * (value - self.points[-2][0]) >= 0.0:
            del self.points[-2:]


class Frames:
    """Samples of three topics joined by stamp; one writer (the node), any number of readers (open pages).

    A sample is complete once a later measurement comes: estimate and reference of a stamp follow its measurement.

    Parameters
    ----------
    least_turn : of the deflection, for a turning point that is told [m]
    """

    def __init__(self, least_turn: float = math.inf) -> None:
        self._turns = TurningPoints(least_turn)
        self._lock = threading.Lock()
        self._open: dict[int, list[float]] = {}
        self._done: deque[list[float]] = deque(maxlen=_KEPT)
        self._count = 0
        self._reference = _NAN
        self.stopped = False

    def measured(
        self,
        stamp_ns: int,
        current: float,
        resistance: float,
        deflection: float,
        expected: Expected = Expected(),  # noqa: B008  # cannot be changed
    ) -> None:
        """Take a measurement [A, ohm, m] at a stamp [ns]; what was measured before it is complete.

        Parameters
        ----------
        stamp_ns, current, resistance, deflection : of the measurement
        expected : by the simulation that runs beside the device, where there is one
        """
        with self._lock:
            if stamp_ns in self._open:
                return
            for row in self._open.values():
                self._done.append(row)
                self._count += 1
            row = [stamp_ns * 1e-9, current, resistance, deflection, _NAN, _NAN, self._reference, *expected]
            self._open = {stamp_ns: row}
            self._turns.follow(deflection, (current, resistance, deflection))

    def estimated(self, stamp_ns: int, deflection: float, bound: float) -> None:
        """Take an estimate and its bound [m]; one that comes too late for its sample is left out."""
        with self._lock:
            if stamp_ns in self._open:
                self._open[stamp_ns][4:6] = deflection, bound

    def referred(self, stamp_ns: int, deflection: float) -> None:
        """Take a set-point [m] for the sample of a stamp, which holds until the next."""
        with self._lock:
            self._reference = deflection
            if stamp_ns in self._open:
                self._open[stamp_ns][6] = deflection

    def since(self, count: int) -> tuple[int, str]:
        """Return how many samples there have been, and those behind the first `count` as a line of JSON.

        Parameters
        ----------
        count : of samples that the page has already; 0 for a new one
        """
        with self._lock:
            new = min(self._count - count, len(self._done)) if count else min(len(self._done), 1)
            rows = [self._done[k] for k in range(len(self._done) - new, len(self._done))]
            total, stopped = self._count, self.stopped
            turns = [place for _, place in self._turns.points]
        plain, memory = ([[_rounded(value) for value in row] for row in each] for each in (rows, turns))
        told = {"rows": plain, "memory": memory, "stopped": stopped}
        return total, json.dumps(told, separators=(",", ":"))


def _rounded(value: float) -> float | None:
    """Six figures are more than a screen shows; JSON has no NaN. Times need more, and are below 1e10."""
    if not math.isfinite(value):
        return None
    return round(value, 6) if abs(value) > 1e6 else float(f"{value:.9g}")
