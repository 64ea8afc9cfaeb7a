"""The figures that a proof must show: one line a question, with count, Wilson interval, and what is wanted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass

from scipy.stats import binomtest

from vo2_studies.challenge.judging import SETTINGS, Judgement
from vo2_studies.challenge.plan import KINDS

__all__ = ["LINES", "Figure", "Line", "figures", "hardest", "interval", "rate"]

FEWEST = 8
"""Cases below which a condition is not called the hardest."""


@dataclass(frozen=True)
class Line:
    """One question: asked of which kinds, the answer of a case, and the rate that is wanted.

    `side` is "least" or "most".
    """

    key: str
    words: str
    kinds: tuple[str, ...]
    answer: Callable[[Judgement], bool | None]
    wanted: float
    side: str


LINES = (
    Line(
        "unchanged_any_name",
        "unchanged, same day and others: any name",
        ("none", "day"),
        lambda j: None if j.failure else j.alarm,
        0.02,
        "most",
    ),
    Line(
        "moved_right_constant",
        "constants moved only: drifted, with the right constant",
        ("moved",),
        lambda j: j.constant,
        0.90,
        "least",
    ),
    Line(
        "change_first_name",
        "change since calibration: right first name",
        ("one",),
        lambda j: j.top1,
        0.95,
        "least",
    ),
    Line(
        "change_name_or_siblings",
        "change since calibration: right first name or sibling set",
        ("one",),
        lambda j: j.sibling,
        0.95,
        "least",
    ),
    Line(
        "change_wrong_name",
        "change since calibration: a wrong name or set",
        ("one",),
        lambda j: None if j.failure else j.wrong,
        0.03,
        "most",
    ),
    Line(
        "change_family", "change since calibration: right family", ("one",), lambda j: j.family, 0.98, "least"
    ),
    Line(
        "always_name_or_siblings",
        "there all along: right first name or sibling set",
        ("always",),
        lambda j: j.sibling,
        0.85,
        "least",
    ),
    Line(
        "always_wrong_name",
        "there all along: a wrong name",
        ("always",),
        lambda j: None if j.failure else j.wrong,
        0.03,
        "most",
    ),
    Line("two_both", "two effects: both", ("two",), lambda j: j.both, 0.80, "least"),
    Line("two_one", "two effects: at least one", ("two",), lambda j: j.either, 0.97, "least"),
    Line(
        "two_wrong_name",
        "two effects: a wrong name besides",
        ("two",),
        lambda j: None if j.failure else j.extra,
        0.05,
        "most",
    ),
    Line(
        "outside_unknown_family",
        "outside: unknown, with the right family",
        ("outside",),
        lambda j: bool(j.unknown and j.family),
        0.90,
        "least",
    ),
    Line(
        "outside_wrong_name",
        "outside: a wrong name",
        ("outside",),
        lambda j: None if j.failure else j.wrong,
        0.03,
        "most",
    ),
    Line(
        "beside_first_name",
        "beside a moved constant: right first name",
        ("beside",),
        lambda j: j.top1,
        0.95,
        "least",
    ),
    Line("verdict", "verdict right", KINDS, lambda j: j.verdict, 0.95, "least"),
)
"""A case without diagnosis is wrong wherever something is to be found, and left out where a name would be wrong.

The last two are ours: wanted is what is asked of a change, and of names."""


@dataclass(frozen=True)
class Figure:
    """The answer to one line under one condition.

    Attributes
    ----------
    key, words, wanted, side : of the line
    heading, value_of : what the cases have in common ("all", "")
    rate, interval, count : share, its Wilson interval (95 %), cases
    met : the rate is on the wanted side
    """

    key: str
    words: str
    wanted: float
    side: str
    heading: str
    value_of: str
    rate: float
    interval: tuple[float, float]
    count: int

    @property
    def met(self) -> bool:
        return self.rate >= self.wanted if self.side == "least" else self.rate <= self.wanted

    @property
    def shortfall(self) -> float:
        """How far the rate is on the wrong side; negative where it is met."""
        return self.wanted - self.rate if self.side == "least" else self.rate - self.wanted

    def plain(self) -> dict:
        return {**asdict(self), "interval": list(self.interval), "met": self.met}


def interval(right: int, count: int) -> tuple[float, float]:
    """Return the Wilson interval of a rate, 95 per cent."""
    found = binomtest(right, count).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def rate(answers: Iterable[bool | None]) -> tuple[float | None, list[float] | None, int]:
    """Return rate, Wilson interval and count of the answers that are not None."""
    known = [bool(answer) for answer in answers if answer is not None]
    if not known:
        return None, None, 0
    return sum(known) / len(known), list(interval(sum(known), len(known))), len(known)


def figures(judgements: Sequence[Judgement], heading: str = "all") -> list[Figure]:
    """Return the lines over all cases, or split by a heading of `SETTINGS`; lines without case are left out.

    Cases with an effect below the counted excess are left out.
    """
    counted = [j for j in judgements if j.counted]
    split = [""] if heading == "all" else sorted({str(j.settings.get(heading, "")) for j in counted})
    found = []
    for value in split:
        cases = [j for j in counted if heading == "all" or str(j.settings.get(heading, "")) == value]
        for line in LINES:
            share, bounds, count = rate(line.answer(j) for j in cases if j.kind in line.kinds)
            if share is not None and bounds is not None:
                found.append(
                    Figure(
                        line.key, line.words, line.wanted, line.side, heading, value, share,
                        (bounds[0], bounds[1]), count,
                    )
                )  # fmt: skip
    return found


def hardest(judgements: Sequence[Judgement]) -> list[Figure]:
    """Return the figures of all splits with enough cases, the one that falls shortest first."""
    every = [f for heading in SETTINGS for f in figures(judgements, heading) if f.count >= FEWEST]
    return sorted(every, key=lambda f: (-f.shortfall, -f.count))
