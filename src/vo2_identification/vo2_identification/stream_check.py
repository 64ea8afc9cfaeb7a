"""What is missing of a topic, told while its messages arrive."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median

__all__ = ["StreamCheck", "compare_beginnings"]

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
_ANOTHER_CLOCK_NS = 86_400 * _NS
"""Between a stamp and the time of day, from which on the stamps are simulated time."""


class StreamCheck:
    """Counts messages lost on the way, and stamps that the source left out.

    Every publisher numbers its messages, so a number that is skipped is a message that was sent and did not arrive. A
    gap in the stamps without one is a sample that its source never sent.

    Attributes
    ----------
    lost : messages that were sent and did not arrive
    gaps, missing : places where stamps jump ahead, and sample periods left out there
    samples : stamps heard
    first_gap_ns : stamp after which the first gap follows, None without any
    first_ns, first_number : of the first sample heard, None before
    """

    def __init__(self) -> None:
        self.lost = self.gaps = self.missing = self.samples = 0
        self.first_gap_ns: int | None = None
        self.first_ns: int | None = None
        self.first_number: int | None = None
        self._late = ""
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
        if self.first_number is None:
            self.first_number = number
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

    def hear_stamp(self, stamp_ns: int, *, steady: bool = True) -> None:
        """Note the stamp of a sample [ns]; `steady` is whether a gap in the topic's stamps says anything."""
        if self.first_ns is None:
            self.first_ns = stamp_ns
        if not steady:
            return
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
            self._period_ns = self.period_ns
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

    def begin_late(self, other: str, late_ns: int, samples: int, *, lost: bool) -> None:
        """Note what was sent before the first sample heard, as an earlier stamp on another topic shows.

        Parameters
        ----------
        other : topic on which the earlier stamp was heard
        late_ns : by which the first sample heard is later [ns]
        samples : sample periods between the two
        lost : whether they count as messages that did not arrive
        """
        self._late = f"begins {late_ns / _NS:.6f} s later than {other}: {samples} sample periods before are not in the bag"
        if lost:
            self.lost += samples

    @property
    def period_ns(self) -> float:
        """Usual step between stamps [ns], 0 before there are two."""
        return self._period_ns or (median(self._steps) if self._steps else 0.0)

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
        if self._late:
            parts.append(self._late)
        return "; ".join(parts)


def compare_beginnings(checks: Mapping[str, StreamCheck], now_ns: int) -> None:
    """Note which topic of a loop was heard later than the others although its publisher had spoken before.

    The samples of one period carry one stamp on all topics of a loop. In simulated time every topic has each of
    them, as nothing goes on before it was answered: what is absent is lost, where the loop was heard from its
    beginning on. Else the listener, or a node of the loop, may just have come later.

    Parameters
    ----------
    checks : topic -> what was heard of it, of the topics of one loop
    now_ns : time of day [ns]
    """
    begun = {topic: check.first_ns for topic, check in checks.items() if check.first_ns is not None}
    if not begun:
        return
    other = min(begun, key=lambda topic: begun[topic])
    first_ns = begun[other]
    from_the_start = (checks[other].first_number or 1) <= _FIRST_WORDS
    simulated = abs(now_ns - first_ns) > _ANOTHER_CLOCK_NS
    period_ns = min((check.period_ns for check in checks.values() if check.period_ns), default=0.0)
    for topic, start_ns in begun.items():
        # the first message of a publisher has number 1: nothing was sent before it
        if start_ns > first_ns and (checks[topic].first_number or 1) > 1:
            samples = max(1, round((start_ns - first_ns) / period_ns)) if period_ns else 1
            checks[topic].begin_late(other, start_ns - first_ns, samples, lost=from_the_start and simulated)
