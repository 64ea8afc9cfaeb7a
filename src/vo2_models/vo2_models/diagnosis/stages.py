"""What the stages of a diagnosis returned, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vo2_models.diagnosis.decide import Decision
from vo2_models.diagnosis.evident import Evident
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.locate import Located
from vo2_models.diagnosis.read import Reading
from vo2_models.diagnosis.search import Search

__all__ = ["Study"]


@dataclass(frozen=True)
class Study:
    """Everything behind a diagnosis: what the report draws and the next experiment is designed from.

    Attributes
    ----------
    reading : the recordings, ready
    located : the problem without effects, and where its excess is
    search : what was tried
    decision : what is named, and how well it does
    limits : with which it was decided
    seconds : spent
    days : name of each recording and the study that is of it, in the order given, where not all have the same answer: all else
        is of one of these studies, which has none itself. Empty where all recordings are judged together
    """

    reading: Reading
    located: Located
    search: Search
    decision: Decision
    limits: Limits
    seconds: float
    days: tuple[tuple[str, Study], ...] = ()

    @property
    def shown(self) -> tuple[Evident, ...]:
        """What the values show by themselves, without the swings that are a minor part of what has no name."""
        return tuple(one for one in self.reading.evident if not self.is_part_of_the_unnamed(one))

    def is_part_of_the_unnamed(self, one: Evident) -> bool:
        """Whether a swing at one frequency explains the smaller part of its channel's error, and the rest has no name."""
        if (
            "line" not in one.record.hooks
            or self.decision.verdict != "differs"
            or self.decision.chosen is not None
        ):
            return False
        return one.explained < self.limits.line

    @property
    def verdict(self) -> Literal["agrees", "drifted", "differs"]:
        """What was decided; what the values show by themselves is a difference, however well all else agrees."""
        return "differs" if self.reading.evident else self.decision.verdict
