"""A claim: what was published, what we find, under which conditions, and the rule that says whether it is met."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Claim", "Context", "Figure", "Rule", "Section", "at_least", "at_most", "within"]


@dataclass(frozen=True)
class Rule:
    """When a claim counts as met: a sentence for the reader and the test."""

    text: str
    holds: Callable[[float], bool]


def within(published: float, fraction: float) -> Rule:
    """Met if ours is within a fraction of the published value."""
    return Rule(
        f"within {100 * fraction:g} % of {published:g}",
        lambda ours: abs(ours - published) <= fraction * abs(published),
    )


def at_most(limit: float) -> Rule:
    """Met if ours is not larger."""
    return Rule(f"at most {limit:g}", lambda ours: ours <= limit)


def at_least(limit: float) -> Rule:
    """Met if ours is not smaller."""
    return Rule(f"at least {limit:g}", lambda ours: ours >= limit)


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
    """

    id: str
    section: str
    claim: str
    published: float | None
    ours: float
    unit: str
    rule: Rule
    conditions: str = ""

    @property
    def met(self) -> bool:
        return bool(math.isfinite(self.ours) and self.rule.holds(self.ours))

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
            "rule": self.rule.text,
            "conditions": self.conditions,
        }


@dataclass(frozen=True)
class Figure:
    """A redrawn figure as SVG text, with its caption."""

    caption: str
    svg: str


@dataclass(frozen=True)
class Section:
    """What one section of the dissertation gave: claims, figures, and remarks for the reader."""

    number: str
    title: str
    claims: tuple[Claim, ...]
    figures: tuple[Figure, ...] = ()
    remarks: tuple[str, ...] = ()


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
    """

    draws: int = 200
    robust_draws: int = 1000
    seed: int = 1
    workers: int = 1
    folder: Path = Path("reproduction")
    progress: Callable[[str, float], None] = field(default=lambda text, share: None)
