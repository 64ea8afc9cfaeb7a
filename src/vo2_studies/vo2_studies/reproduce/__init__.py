"""Every numerical claim of the dissertation that can be simulated, beside what this code finds: `reproduce`."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Sequence

__all__ = ["main"]

INTERRUPTED = 130
"""Exit status after Ctrl-C, as a shell gives it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Console script; see `vo2_studies.reproduce.command`."""
    main_thread = threading.current_thread() is threading.main_thread()
    # SIGTERM ends it like Ctrl-C: no process of a pool and no node of a scenario is left behind
    before = signal.signal(signal.SIGTERM, signal.default_int_handler) if main_thread else None
    try:
        # the libraries behind the sections take seconds to load, in which Ctrl-C works as later
        from vo2_studies.reproduce.command import run

        return run(arguments)
    except KeyboardInterrupt:
        print("\nreproduce: interrupted", file=sys.stderr)
        return INTERRUPTED
    finally:
        if main_thread:
            signal.signal(signal.SIGTERM, before)
