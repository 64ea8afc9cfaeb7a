"""Proof on concealed data: draw devices and effects at random, hide the answers, score the diagnosis.

The generator is a second, independent simulation. It imports nothing of the device simulation, the
effect records, the hysteresis models or the fitting: every equation here is written from its source,
so that a diagnosis cannot succeed by inverting its own simulator.
"""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command `challenge`; see `vo2_identification.challenge.command`."""
    from vo2_identification.challenge.command import main as command

    return command(argv)
