"""`plants`: many simulated devices in one process, each a `plant` in a namespace of its own.

Device K of the row is the node `/device_K/plant` with seed K; none of them publishes on /clock, as only one may. What
follows `--ros-args` goes to all of them; a parameter file tells them apart by their names:

    /device_3/plant: {ros__parameters: {effects: "{creep: {share: 0.05}}"}}
"""

from __future__ import annotations

import argparse
import inspect
import sys
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from vo2_models.command_line import refuse
from vo2_models.effects.catalogue import add_effects_option

if TYPE_CHECKING:
    from vo2_plant_sim.plant_node import PlantNode

__all__ = ["device", "main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the devices until SIGINT or SIGTERM.

    Parameters
    ----------
    arguments : command line, None for that of the process

    Returns
    -------
    int : exit status
    """
    program, *given = sys.argv if arguments is None else arguments
    parser = argparse.ArgumentParser(
        prog="plants",
        allow_abbrev=False,
        description=inspect.cleandoc(__doc__ or ""),
        epilog="The parameters are those of `plant`, see its --help.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--count", type=int, required=True, metavar="N", help="how many devices")
    parser.add_argument(
        "--first",
        type=int,
        default=0,
        metavar="K",
        help="number of the first, to share a row between processes (default %(default)s)",
    )
    add_effects_option(parser)
    split = given.index("--ros-args") if "--ros-args" in given else len(given)
    options = parser.parse_args(given[:split])
    if options.count < 1 or options.first < 0:
        found = f"--count {options.count} --first {options.first}"
        return refuse("plants", f"found {found}, need at least 1 device and numbers from 0 on")
    from vo2_interface.executable import run_nodes
    from vo2_interface.timers import sharing_timers

    makes = [partial(device, number) for number in range(options.first, options.first + options.count)]
    with sharing_timers():
        return run_nodes(*makes, args=[program, *given[split:]])


def device(number: int) -> PlantNode:
    """Return the node of a device of the row, made as `plants` makes it.

    Parameters
    ----------
    number : of the device: its namespace ends with it, and it is its seed

    Returns
    -------
    PlantNode : in the namespace `/device_NUMBER`

    Raises
    ------
    ValueError : ROS arguments put all nodes of the process into one namespace.
    """
    # loads the compiler: not for --help
    from vo2_plant_sim.plant_node import PlantNode

    space = f"/device_{number}"
    node = PlantNode(space, {"seed": number, "clock": False})
    if (found := node.get_namespace()) != space:
        raise ValueError(f"found the namespace {found} for all devices, need no __ns: each has its own")
    return node
