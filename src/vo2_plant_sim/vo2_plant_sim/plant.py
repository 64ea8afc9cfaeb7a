"""Executable `plant`: takes `--effects DIR`, which decides what parameters the node has, before the node is loaded."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from vo2_models.effects.catalogue import add_effects_option

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Console script; everything but `--effects` goes to the node.

    Parameters
    ----------
    arguments : command line, None for that of the process

    Returns
    -------
    int : exit status
    """
    parser = argparse.ArgumentParser(prog="plant", add_help=False, allow_abbrev=False)
    add_effects_option(parser)
    program, *given = sys.argv if arguments is None else arguments
    _, rest = parser.parse_known_args(given)
    from vo2_plant_sim.plant_node import main as run

    return run([program, *rest])
