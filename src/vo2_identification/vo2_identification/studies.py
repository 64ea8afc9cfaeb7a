"""The commands whose code is in `vo2_studies`, under the names that they have in this package."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib import import_module

__all__ = ["challenge", "examples", "measured", "reproduce"]


def _command(name: str, module: str) -> Callable[[Sequence[str] | None], int]:
    def main(argv: Sequence[str] | None = None) -> int:
        try:
            found = import_module(module)
        except ModuleNotFoundError as error:
            if error.name != "vo2_studies":
                raise
            print(
                f"{name}: the package vo2_studies is not installed; build it beside this one", file=sys.stderr
            )
            return 2
        return int(found.main(argv))

    return main


challenge = _command("challenge", "vo2_studies.challenge")
examples = _command("examples", "vo2_studies.examples.command")
measured = _command("measured", "vo2_studies.measured.command")
reproduce = _command("reproduce", "vo2_studies.reproduce")
