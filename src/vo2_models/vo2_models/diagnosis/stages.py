"""What the stages of a diagnosis returned, side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vo2_models.diagnosis.decide import Decision
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
    """

    reading: Reading
    located: Located
    search: Search
    decision: Decision
    limits: Limits
    seconds: float

    @property
    def verdict(self) -> Literal["agrees", "drifted", "differs"]:
        """What was decided; what the values show by themselves is a difference, however well all else agrees."""
        return "differs" if self.reading.evident else self.decision.verdict
