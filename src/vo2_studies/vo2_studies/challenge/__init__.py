"""Proof on concealed data: draw devices and effects at random, hide the answers, score the diagnosis.

The generator is a second, independent simulation. It imports nothing of the device simulation, the
effect records, the hysteresis models or the fitting: every equation here is written from its source,
so that a diagnosis cannot succeed by inverting its own simulator.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command `challenge`; see `vo2_studies.challenge.command`."""
    try:  # the libraries take seconds to load, in which Ctrl-C works as later
        from vo2_studies.challenge.command import main as command

        return command(argv)
    except KeyboardInterrupt:
        print("challenge: interrupted", file=sys.stderr)
        return 130
