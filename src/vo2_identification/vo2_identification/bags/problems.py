"""What was found wrong with a bag, with its place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from vo2_models.io import InputError, one_line
from vo2_models.units import stamp_in_words

__all__ = ["BagError", "Problem", "in_few_lines", "limited"]

_KINDS = {
    "gap": "gaps",
    "nan": "stretches without a value",
    "non_monotonic": "samples out of order",
    "restart": "stretches before or after a jump of the clock",
    "malformed": "samples that cannot be read",
}


class BagError(InputError):
    """A bag that cannot be used at all; the message is one line that names it and the remedy."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a recording that could be read nevertheless.

    Attributes
    ----------
    kind : `gap`, `non_monotonic`, `restart`, `nan`, `absent_channel`, `malformed`, `missing_topic`,
        `other_namespace`, `other_device`, `negative_time`, `truncated`, `corrupt`, `metadata`, `missing_file`, `repeat`,
        `uncommanded`, `more`
    topic : topic name, or the file name where a file is meant
    text : what was found, in words
    time_s : stamp [s] of the place, None where a time has no meaning
    index : sample number in the topic (from 0), or byte offset in a file
    """

    kind: str
    topic: str
    text: str
    time_s: float | None = None
    index: int | None = None

    def __str__(self) -> str:
        place = [self.topic]
        if self.time_s is not None:
            place.append(f"at {stamp_in_words(self.time_s, digits=9)}")
        if self.index is not None:
            in_file = self.kind in {"truncated", "corrupt", "metadata", "missing_file"}
            place.append(f"{'byte' if in_file else 'sample'} {self.index}")
        return one_line(f"{' '.join(place)}: {self.text}")


def limited(found: Iterable[Problem], most: int = 20) -> list[Problem]:
    """Return the first `most` problems and, if there are more, one that counts the rest.

    Parameters
    ----------
    found : problems, any number
    most : how many are kept
    """
    every = list(found)
    if len(every) <= most:
        return every
    rest = len(every) - most
    return [*every[:most], Problem("more", every[0].topic, f"{rest} more of kind {every[0].kind}")]


def in_few_lines(found: Iterable[Problem], most: int = 5) -> list[Problem]:
    """Return at most `most` problems of each kind and topic and, in place of the others, how many there are.

    For people: a terminal full of alike lines hides the one that matters.

    Parameters
    ----------
    found : problems, any number
    most : how many of a kind are kept
    """
    lines: list[Problem] = []
    shown: dict[tuple[str, str], int] = {}
    rest: dict[tuple[str, str], int] = {}
    for problem in found:
        if problem.kind == "more":
            hidden = int(problem.text.split(" ", 1)[0])
            kind = problem.text.rsplit(" ", 1)[-1]
        else:
            hidden, kind = 1, problem.kind
        key = (kind, problem.topic)
        if problem.kind != "more" and shown.get(key, 0) < most:
            shown[key] = shown.get(key, 0) + 1
            lines.append(problem)
        else:
            rest[key] = rest.get(key, 0) + hidden
    for (kind, topic), count in rest.items():
        words = _KINDS.get(kind, f"of kind {kind}")
        lines.append(Problem("more", topic, f"{count} more {words}"))
    return lines
