"""Ctrl-C that is not lost: a callback of a compiler or a destructor swallows the exception that it raises there."""

from __future__ import annotations

import threading
from types import FrameType

__all__ = ["forget", "interrupted", "raise_if_interrupted"]

_asked = threading.Event()


def interrupted(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise here, and again wherever `raise_if_interrupted` is called.

    Parameters
    ----------
    number, frame : as `signal.signal` gives them

    Raises
    ------
    KeyboardInterrupt : always.
    """
    _asked.set()
    raise KeyboardInterrupt


def forget() -> None:
    """Begin anew: no signal has come yet."""
    _asked.clear()


def raise_if_interrupted() -> None:
    """Raise what a signal has asked for and nobody has seen.

    Raises
    ------
    KeyboardInterrupt : a signal came.
    """
    if _asked.is_set():
        _asked.clear()
        raise KeyboardInterrupt
