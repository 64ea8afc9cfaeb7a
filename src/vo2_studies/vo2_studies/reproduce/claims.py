"""A claim: what was published, what we find, under which conditions, and the rule that says whether it is met."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from vo2_studies.reproduce.pool import Finished

__all__ = [
    "Claim",
    "Context",
    "Figure",
    "Rule",
    "Section",
    "Table",
    "Tally",
    "above",
    "at_least",
    "at_most",
    "baseline",
    "below",
    "between",
    "tally",
    "within",
    "within_or_above",
    "within_or_below",
]


Found = TypeVar("Found")


@dataclass(frozen=True)
class Rule:
    """When a claim counts as met: a sentence for the reader, and the interval that ours must lie in.

    Attributes
    ----------
    low, high : ends, which belong to the interval; None where there is none
    """

    text: str
    low: float | None = None
    high: float | None = None

    def holds(self, ours: float) -> bool:
        """Whether a value lies in the interval."""
        return (self.low is None or ours >= self.low) and (self.high is None or ours <= self.high)


def within(published: float, fraction: float) -> Rule:
    """Met if ours is within a fraction of the published value."""
    distance = fraction * abs(published)
    return Rule(f"within {100 * fraction:g} % of {published:g}", published - distance, published + distance)


def within_or_below(published: float, fraction: float) -> Rule:
    """Met if ours is within a fraction of the published value, or smaller: what is better smaller."""
    text = f"within {100 * fraction:g} % of {published:g}, or smaller"
    return Rule(text, high=published + fraction * abs(published))


def within_or_above(published: float, fraction: float) -> Rule:
    """Met if ours is within a fraction of the published value, or larger: what is better larger."""
    text = f"within {100 * fraction:g} % of {published:g}, or larger"
    return Rule(text, low=published - fraction * abs(published))


def baseline(published: float) -> Rule:
    """Met if what a proposal is compared with is about as good as published: a better one reproduces nothing."""
    return within(published, 0.2)


def between(low: float, high: float) -> Rule:
    """Met if ours lies between two limits."""
    return Rule(f"{low:g} to {high:g}", low, high)


def at_most(limit: float) -> Rule:
    """Met if ours is not larger."""
    return Rule(f"at most {limit:g}", high=limit)


def at_least(limit: float) -> Rule:
    """Met if ours is not smaller."""
    return Rule(f"at least {limit:g}", low=limit)


def above(limit: float) -> Rule:
    """Met if ours is larger."""
    return Rule(f"above {limit:g}", low=math.nextafter(limit, math.inf))


def below(limit: float, text: str) -> Rule:
    """Met if ours is smaller; the limit needs words of its own."""
    return Rule(text, high=math.nextafter(limit, -math.inf))


@dataclass(frozen=True)
class Claim:
    """One line of the page.

    Attributes
    ----------
    id : unique, `section.name`
    section : of the dissertation, as `8.4.1`
    claim : in words
    published : value of the dissertation, None for a claim of our own
    ours : computed value; NaN counts as not met
    unit : of both
    rule : when it is met
    conditions : under which ours was found
    contradicted : what in the published text contradicts this claim; empty where nothing does
    derived : whether ours comes from other printed figures, which is no reproduction; counted apart
    given : whether ours was set or fitted to the published value, which is no reproduction either; counted apart
    """

    id: str
    section: str
    claim: str
    published: float | None
    ours: float
    unit: str
    rule: Rule
    conditions: str = ""
    contradicted: str = ""
    derived: bool = False
    given: bool = False

    @property
    def state(self) -> str:
        """`contradicted`, `met` or `missed`; for what is no reproduction `consistent` (derived) or `given` in place of `met`."""
        if self.contradicted:
            return "contradicted"
        return (
            "missed" if not self.met else "consistent" if self.derived else "given" if self.given else "met"
        )

    @property
    def met(self) -> bool:
        """Whether the rule holds; a claim that the text itself contradicts is neither met nor missed."""
        return bool(not self.contradicted and math.isfinite(self.ours) and self.rule.holds(self.ours))

    def record(self) -> dict[str, object]:
        """The entry of `reproduction.json`; a value that is not finite is written as null."""
        return {
            "id": self.id,
            "section": self.section,
            "claim": self.claim,
            "published": self.published,
            "ours": float(self.ours) if math.isfinite(self.ours) else None,
            "unit": self.unit,
            "met": self.met,
            "state": self.state,
            "derived": self.derived,
            "given": self.given,
            "contradicted": self.contradicted,
            "rule": self.rule.text,
            "conditions": self.conditions,
        }


@dataclass(frozen=True)
class Figure:
    """A redrawn figure as SVG text, with its caption."""

    caption: str
    svg: str


@dataclass(frozen=True)
class Table:
    """A table of texts with its caption."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Section:
    """What one section of the dissertation gave: claims, figures, and remarks for the reader.

    Attributes
    ----------
    story : paragraphs, tables and figures that stand in front of the claims, in their order
    """

    number: str
    title: str
    claims: tuple[Claim, ...]
    figures: tuple[Figure, ...] = ()
    remarks: tuple[str, ...] = ()
    story: tuple[str | Table | Figure, ...] = ()


@dataclass(frozen=True)
class Tally:
    """How many claims with a published value are met, missed and contradicted; and how many of our own hold.

    Attributes
    ----------
    consistent, inconsistent : figures that the text derives from others, and those of them that do not follow
    given, given_missed : printed figures that ours was set or fitted to, and those of them that were not reached
    """

    met: int
    missed: int
    contradicted: int
    own_met: int
    own: int
    consistent: int = 0
    inconsistent: int = 0
    given: int = 0
    given_missed: int = 0

    def __str__(self) -> str:
        published = self.met + self.missed + self.contradicted
        parts = [
            f"{published} published values: {self.met} met, {self.missed} missed, {self.contradicted} contradicted by the "
            "text itself"
        ]
        if self.consistent + self.inconsistent:
            parts.append(
                f"{self.consistent} figures that the text derives follow from its others, {self.inconsistent} do not"
            )
        if self.given + self.given_missed:
            missed = f" ({self.given_missed} of them not reached)" if self.given_missed else ""
            parts.append(
                f"{self.given + self.given_missed} figures were set or fitted to the printed ones{missed}"
            )
        if self.own:
            parts.append(f"of {self.own} claims of our own {self.own_met} met")
        return "; ".join(parts)


def tally(claims: Iterable[Claim]) -> Tally:
    """Count claims by their state."""
    claims = list(claims)
    derived = [c.state for c in claims if c.derived]
    given = [c.state for c in claims if c.given and not c.contradicted]
    published = [
        c.state
        for c in claims
        if c.published is not None and not c.derived and (c.contradicted or not c.given)
    ]
    own = [c.met for c in claims if c.published is None]
    return Tally(
        met=published.count("met"),
        missed=published.count("missed"),
        contradicted=published.count("contradicted"),
        own_met=sum(own),
        own=len(own),
        consistent=derived.count("consistent"),
        inconsistent=len(derived) - derived.count("consistent"),
        given=given.count("given"),
        given_missed=len(given) - given.count("given"),
    )


@dataclass(frozen=True)
class Context:
    """How much to compute.

    Attributes
    ----------
    draws : devices of the comparisons over device draws
    robust_draws : devices of the robustness study
    seed : of the first device; device k has seed + k
    workers : processes
    folder : where recordings of scenarios go, one folder each
    progress : called with what is being done and the share of the section done, 0 to 1
    code : identity of the code that a section is computed by
    """

    draws: int = 200
    robust_draws: int = 1000
    seed: int = 1
    workers: int = 1
    folder: Path = Path("reproduction")
    progress: Callable[[str, float], None] = field(default=lambda text, share: None)
    code: str = ""

    def finished(
        self, number: str, encode: Callable[[Found], Any], decode: Callable[[Any], Found]
    ) -> Finished[Found]:
        """Where a long section keeps its finished devices, see `pool.run_many`.

        Parameters
        ----------
        number : of the section
        encode, decode : a result as what JSON takes, and back
        """
        identity = f"{self.code} seed {self.seed} draws {self.draws} {self.robust_draws}"
        return Finished(self.folder / "unfinished" / f"{number}.jsonl", identity, encode, decode)
