"""Stamps in a loop: a repeated sample is answered again, never computed again; a late one is dropped.

Until its sample is answered the plant repeats it, so that a node found late cannot stop the loop. A node
that has answered a stamp sends the same answer once more (the first may have found nobody listening) and
leaves its state alone; a receiver that has used an answer drops the copy. A sample older than the newest one
is a late copy or out of order, unless nothing but older ones comes: then the source has started anew.
"""

from __future__ import annotations

import math
import time
from typing import Literal

__all__ = ["HOLD_SAMPLES", "REPEAT_S", "Order", "SampleAge", "StampOrder"]

Order = Literal["new", "repeat", "late", "restart"]

REPEAT_S = 0.2
"""Wall time after which an unanswered sample is repeated [s]."""
HOLD_SAMPLES = 3
"""Sample periods for which a loop without input holds its last command before the safe current."""
_RESTART_S = 2.0 * REPEAT_S
_RESTART_SAMPLES = 20
"""A source that lives shows its newest stamp at least every `REPEAT_S`: older stamps alone, in order, for twice that
time or so many in a row, come from one that started anew (a plant, or a bag replayed faster than it was recorded)."""
_DRIFT = 2e-4
"""By how much the clock of a rig may run slower than that of this host [1]: quartz, with a margin."""


class StampOrder:
    """Tells new, repeated and late stamps of one topic apart, and those of a source that started anew.

    Attributes
    ----------
    last_ns : the newest stamp accepted, None before the first
    """

    def __init__(self) -> None:
        self.last_ns: int | None = None
        self._older = 0
        self._older_ns = 0
        self._since_s = -math.inf

    def judge(self, stamp_ns: int) -> Order:
        """Return what a stamp that has just arrived is; a `late` one is to be dropped."""
        if self.last_ns is None or stamp_ns > self.last_ns:
            self._older = 0
            return "new"
        if stamp_ns == self.last_ns:
            self._older = 0
            return "repeat"
        now_s = time.monotonic()
        if self._older == 0 or stamp_ns < self._older_ns:
            self._older, self._since_s = 0, now_s
        self._older += 1
        self._older_ns = stamp_ns
        if self._older < _RESTART_SAMPLES and now_s - self._since_s < _RESTART_S:
            return "late"
        self._older, self.last_ns = 0, None
        return "restart"

    def accept(self, stamp_ns: int) -> None:
        """Remember `stamp_ns` as the newest."""
        self.last_ns = stamp_ns


class SampleAge:
    """How old samples are by their stamps, whatever clock the rig stamps with.

    The fastest delivery so far counts as none, so that neither a step of this host's time of day nor a rig with a
    clock of its own disturbs it; a sample is as old as it came later than that.
    """

    def __init__(self) -> None:
        self._offset_s = math.inf
        self._at_s = 0.0

    def hear(self, stamp_ns: int, now_s: float) -> None:
        """Note a sample that arrives at `now_s` of a clock that does not jump [s]."""
        self._offset_s = min(now_s - 1e-9 * stamp_ns, self._offset_s + _DRIFT * (now_s - self._at_s))
        self._at_s = now_s

    def age_s(self, stamp_ns: int, now_s: float) -> float:
        """Return how old a sample is at `now_s` [s]."""
        return now_s - 1e-9 * stamp_ns - self._offset_s

    def stamp_s(self, now_s: float) -> float:
        """Return what a sample taken at `now_s` would be stamped with [s]; minus infinity before the first."""
        return now_s - self._offset_s
