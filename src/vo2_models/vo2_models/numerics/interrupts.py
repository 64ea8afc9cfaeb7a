"""Ctrl-C that is not lost in the compiler.

Python raises KeyboardInterrupt in whatever it runs at that moment. Where that is a callback of a compiled library, as the
one by which LLVM hands over what it has compiled, or a destructor, the exception is printed and dropped, and the program
goes on as if nobody had asked it to end.
"""

from __future__ import annotations

import signal
import sys
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

__all__ = ["raise_again"]

_SOON_S = 0.05
"""Until an interrupt that was dropped comes again [s]; it may meet the next callback and is dropped and comes once more."""


def raise_again() -> None:
    """From now on, a KeyboardInterrupt that Python drops comes again, to the main thread; other errors are shown as before."""
    before = sys.unraisablehook

    def hook(dropped: UnraisableHookArgs) -> None:
        if not isinstance(dropped.exc_value, KeyboardInterrupt):
            before(dropped)
            return
        again = threading.Timer(_SOON_S, _interrupt)
        again.daemon = True
        again.start()

    sys.unraisablehook = hook


def _interrupt() -> None:
    """Send the main thread, which may wait in the system, a signal that is handled: SIGINT is ignored in a shell's background."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if callable(signal.getsignal(number)):
            signal.pthread_kill(threading.main_thread().ident or 0, number)
            return
