"""Stamps in a lockstep loop: a repeated sample is answered again, never computed again.

Until its sample is answered the plant repeats it, so that a node found late cannot stop the loop. A node
that has answered a stamp sends the same answer once more (the first may have found nobody listening) and
leaves its state alone; a receiver that has used an answer drops the copy.
"""

from __future__ import annotations

__all__ = ["HOLD_SAMPLES", "REPEAT_S", "StampOrder"]

REPEAT_S = 0.2
"""Wall time after which an unanswered sample is repeated [s]."""
HOLD_SAMPLES = 3
"""Sample periods for which a loop without input holds its last command before the safe current."""


class StampOrder:
    """Tells new, repeated and older stamps of one topic apart.

    Attributes
    ----------
    last_ns : the newest stamp accepted, None before the first
    """

    def __init__(self) -> None:
        self.last_ns: int | None = None

    def is_repeat(self, stamp_ns: int) -> bool:
        """Whether this stamp is the one accepted last."""
        return stamp_ns == self.last_ns

    def jumped_back(self, stamp_ns: int) -> bool:
        """Whether this stamp is older than the one accepted last: a restarted source, or disorder."""
        return self.last_ns is not None and stamp_ns < self.last_ns

    def accept(self, stamp_ns: int) -> None:
        """Remember `stamp_ns` as the newest."""
        self.last_ns = stamp_ns
