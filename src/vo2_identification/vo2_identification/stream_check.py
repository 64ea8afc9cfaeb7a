"""What is missing of a topic, told while its messages arrive."""

from __future__ import annotations

from statistics import median

__all__ = ["StreamCheck"]

_LEARN = 25
"""Steps between stamps whose median is the period that gaps are counted in."""
_GAP = 1.5
"""Periods between two stamps above which samples are missing between them."""
_NS = 1_000_000_000
_KEPT = 16
"""Sequences of publishers that have gone, or are not known yet, which are kept."""
_FARTHEST_JUMP, _FIRST_WORDS, _MEETING = 1000, 100, 200
"""Beside a publisher that was found and not heard yet: a jump in the numbers, a number, and the messages since it was found, from
which or up to which a message is taken for its first one and not for a loss of another's."""


class StreamCheck:
    """Counts messages lost on the way, and stamps that the source left out.

    Every publisher numbers its messages, so a number that is skipped is a message that was sent and did not arrive. A
    gap in the stamps without one is a sample that its source never sent.

    Attributes
    ----------
    lost : messages that were sent after the first one heard, and did not arrive
    gaps, missing : places where stamps jump ahead, and sample periods left out there
    samples : stamps heard
    first_gap_ns : stamp after which the first gap follows, None without any
    """

    def __init__(self) -> None:
        self.lost = self.gaps = self.missing = self.samples = 0
        self.first_gap_ns: int | None = None
        self._numbers: list[int] = []
        self._publishers = self._unheard = self._since = 0
        self._last_ns: int | None = None
        self._steps: list[int] = []
        self._period_ns = 0.0

    def hear_number(self, number: int, publishers: int) -> None:
        """Note the publisher's number of a message; `publishers` is how many the topic has.

        Numbers do not say whose they are: each continues the sequence whose next it is, else the nearest lower one.
        One that is lower than all begins another; so does one that no sequence could have come to, or that comes soon after
        another publisher was found, once for each that was found. Discovery may lag behind what is heard: a sequence is not
        forgotten because fewer publishers are known.
        """
        if publishers > self._publishers:
            self._unheard += publishers - self._publishers
            self._since = 0
        self._publishers = publishers
        self._since += 1
        nearest = max((one for one in self._numbers if one < number), default=None)
        if number - 1 == nearest:
            self._numbers.remove(nearest)
        elif nearest is None or (
            self._unheard
            and (number - nearest > _FARTHEST_JUMP or number <= _FIRST_WORDS or self._since <= _MEETING)
        ):
            self._unheard = max(self._unheard - 1, 0)
        else:
            self.lost += number - nearest - 1
            self._numbers.remove(nearest)
        # the one continued last stands last: those of publishers that have gone drop out in the end
        self._numbers = [*self._numbers, number][-(publishers + _KEPT) :]

    def hear_stamp(self, stamp_ns: int) -> None:
        """Note the stamp of a sample [ns]."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        self.samples += 1
        if last_ns is None or stamp_ns <= last_ns:
            self._steps.clear()
            return
        step = stamp_ns - last_ns
        if not self._period_ns:
            self._steps.append(step)
            if len(self._steps) < _LEARN:
                return
            self._period_ns = median(self._steps)
            start = last_ns + step - sum(self._steps)
            for each in self._steps:
                self._judge(start, each)
                start += each
            return
        self._judge(last_ns, step)

    def _judge(self, after_ns: int, step_ns: int) -> None:
        if step_ns > _GAP * self._period_ns:
            self.gaps += 1
            self.missing += round(step_ns / self._period_ns) - 1
            if self.first_gap_ns is None:
                self.first_gap_ns = after_ns

    @property
    def missing_share(self) -> float:
        """Sample periods left out, as a share of all."""
        return self.missing / max(self.missing + self.samples, 1)

    def words(self) -> str:
        """Return what is missing in words, empty if nothing is."""
        parts = [f"{self.lost} messages were sent and did not arrive"] if self.lost else []
        if self.first_gap_ns is not None:
            parts.append(
                f"{self.missing} sample periods without a sample in {self.gaps} gaps, the first after stamp "
                f"{self.first_gap_ns / _NS:.6f} s"
            )
        return "; ".join(parts)
