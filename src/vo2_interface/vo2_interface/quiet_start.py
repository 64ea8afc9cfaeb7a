"""Console scripts of nodes: Ctrl-C while a node still loads ends it at once, with status 0 and without a traceback."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from importlib import import_module

__all__ = ["quiet_start"]

_ENDS = (signal.SIGINT, signal.SIGTERM)


def quiet_start(module: str) -> Callable[[], int]:
    """Return a console script that loads a module and calls its `main`.

    Until then nothing has been commanded and nobody is connected: there is nothing to end in order. `run_nodes` takes the
    signals over. Those that came before this ran were held back by the script, see `console_scripts`.

    Parameters
    ----------
    module : its name; loading it may take seconds

    Returns
    -------
    callable : returns the exit status
    """

    def main() -> int:
        for number in _ENDS:
            signal.signal(number, lambda *_: os._exit(0))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDS)
        return import_module(module).main()

    return main
