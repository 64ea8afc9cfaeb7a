"""What was found wrong with a bag, with its place."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["BagError", "Problem", "limited"]


class BagError(ValueError):
    """A bag that cannot be used at all; the message is one line that names it and the remedy."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a recording that could be read nevertheless.

    Attributes
    ----------
    kind : `gap`, `non_monotonic`, `restart`, `nan`, `absent_channel`, `malformed`, `missing_topic`,
        `other_namespace`, `other_device`, `negative_time`, `truncated`, `corrupt`, `metadata`, `missing_file`, `more`
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
            place.append(f"at {self.time_s:.9g} s")
        if self.index is not None:
            in_file = self.kind in {"truncated", "corrupt", "metadata", "missing_file"}
            place.append(f"{'byte' if in_file else 'sample'} {self.index}")
        return f"{' '.join(place)}: {self.text}"


def limited(found: Iterable[Problem], most: int = 20) -> list[Problem]:
    """Return the first `most` problems and, if there are more, one that counts the rest."""
    every = list(found)
    if len(every) <= most:
        return every
    rest = len(every) - most
    return [*every[:most], Problem("more", every[0].topic, f"{rest} more of kind {every[0].kind}")]
