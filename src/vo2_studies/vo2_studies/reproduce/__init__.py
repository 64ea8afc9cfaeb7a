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
    from vo2_studies.reproduce.interrupt import forget, interrupted

    forget()

    # SIGTERM ends it like Ctrl-C: no process of a pool and no node of a scenario is left behind
    both = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, interrupted) for number in both] if main_thread else []
    try:
        # the libraries behind the sections take seconds to load, in which Ctrl-C works as later
        from vo2_studies.reproduce.command import run

        return run(arguments)
    except KeyboardInterrupt:
        print("\nreproduce: interrupted", file=sys.stderr)
        return INTERRUPTED
    finally:
        for number, handler in zip(both, before, strict=False):
            signal.signal(number, handler)
