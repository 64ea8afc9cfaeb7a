"""Console scripts that Ctrl-C finds ready from their first millisecond: commands for a `setup.py`.

Python needs a tenth of a second before it runs the first line of a program, a third on a busy machine, and a signal that
comes meanwhile ends it with a traceback or by the signal itself. Such a script is therefore started by `env`, which holds
SIGINT and SIGTERM back until `quiet_start` is ready to hear them.
"""

from __future__ import annotations

import subprocess
import sys
from typing import Any

from setuptools import Command
from setuptools.command.develop import develop
from setuptools.command.install_scripts import install_scripts

__all__ = ["holding"]

_HOLD = ["/usr/bin/env", "--block-signal=INT", "--block-signal=TERM"]


def holding(*entries: str) -> dict[str, type[Command]]:
    """Return the commands of a `setup.py` that write these console scripts so that signals wait for them.

    Where `env` cannot hold signals back (GNU coreutils before 8.31, other makes) the scripts are the ordinary ones.

    Parameters
    ----------
    entries : `name = module:function` as in `console_scripts`; each function is made by `quiet_start`
    """
    try:
        held = subprocess.run([*_HOLD, "true"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        held = False
    if not held:
        return {}
    scripts = {}
    for entry in entries:
        name, target = entry.split(" = ")
        scripts[name] = _script(*target.split(":"))

    class HoldingDevelop(develop):
        def write_script(self, script_name: str, contents: str, *rest: Any) -> None:
            super().write_script(script_name, scripts.get(script_name, contents), *rest)

    class HoldingInstallScripts(install_scripts):
        def write_script(self, script_name: str, contents: str, *rest: Any) -> None:
            super().write_script(script_name, scripts.get(script_name, contents), *rest)

    return {"develop": HoldingDevelop, "install_scripts": HoldingInstallScripts}


def _script(module: str, function: str) -> str:
    # setuptools' own script looks the function up in the metadata of all that is installed, which takes longer than to load it
    start = f'#!{_HOLD[0]} -S {" ".join(_HOLD[1:])} "{sys.executable}"'
    # a process that a node spawns loads the script of its parent again, and must not become a node itself
    end = f'if __name__ == "__main__":\n    sys.exit({function}())'
    return f"{start}\nimport sys\n\nfrom {module} import {function}\n\n{end}\n"
