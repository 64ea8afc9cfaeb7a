"""Every numerical claim of the dissertation that can be simulated, beside what this code finds: `reproduce`."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Console script; see `vo2_identification.reproduce.command`."""
    from vo2_identification.reproduce.command import run

    return run(arguments)
