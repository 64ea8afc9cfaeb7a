"""How well a wall-time loop keeps its periods: what was missed, and how long an answer takes."""

from __future__ import annotations

from bisect import bisect_left
from itertools import accumulate

__all__ = ["LoopTiming"]

_BINS = 4000
_PERIODS = 10
"""Periods that the histogram of the latency spans; what takes longer counts as so long."""
_SETTLE_S = 2.0
"""Time after the first answer before anything counts: nodes still meet, kernels still load."""


class LoopTiming:
    """Counts periods and latencies of a closed loop; cheap enough to be told at every sample.

    Parameters
    ----------
    period_s : sample period [s]

    Attributes
    ----------
    periods : counted, from `_SETTLE_S` after the first command on
    skipped : of them, those in which no sample was taken in time
    unanswered : of them, those whose sample had no command when the next one was taken
    """

    def __init__(self, period_s: float) -> None:
        self._bin_s = period_s * _PERIODS / _BINS
        self._counts = [0] * (_BINS + 1)
        self._from_s = float("inf")
        self.periods = self.skipped = self.unanswered = 0

    def command(self, now_s: float, latency_s: float) -> None:
        """Note an answer; `now_s` is any clock that does not jump, `latency_s` the time since its measurement."""
        if now_s >= self._from_s:
            self._counts[min(int(latency_s / self._bin_s), _BINS)] += 1
        elif self._from_s == float("inf"):
            self._from_s = now_s + _SETTLE_S

    def sample(self, now_s: float, skipped: int, answered: bool) -> None:
        """Note a sample, how many before it were not taken, and whether the last one was answered."""
        if now_s >= self._from_s:
            self.periods += 1 + skipped
            self.skipped += skipped
            self.unanswered += not answered

    def latency_s(self, share: float) -> float:
        """Return the latency that this share of the answers stays within [s], NaN without any."""
        total = list(accumulate(self._counts))
        if not total[-1]:
            return float("nan")
        # the upper edge of the bin that holds it
        return (bisect_left(total, share * total[-1]) + 1) * self._bin_s

    def values(self) -> dict[str, str]:
        """Return key -> value for a diagnostic status."""
        found = {
            "periods": str(self.periods),
            "skipped": str(self.skipped),
            "unanswered": str(self.unanswered),
        }
        for name, share in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999)):
            found[f"latency_{name}_ms"] = f"{1e3 * self.latency_s(share):.4g}"
        return found
