"""`loop`: plant, estimator and controller composed in one process and one executor, for fast loops.

The same nodes, topics and parameters as in separate processes; `--with-reference` adds the reference node,
`--without-plant` leaves the plant out, for a real device that speaks the same topics. `--with MODULE:CLASS`, as often as
needed, adds a node of any installed package, such as `--with vo2_control.feedforward_node:FeedforwardNode`: a class that is
made without arguments.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence
from importlib import import_module

from rclpy.node import Node
from vo2_estimation.estimator_node import EstimatorNode
from vo2_interface.executable import beside_ros_arguments, run_nodes
from vo2_plant_sim.plant_node import PlantNode

from vo2_control.controller_node import ControllerNode
from vo2_control.reference_node import ReferenceNode

__all__ = ["main"]

_OPTIONS, _HELP = ("--with-reference", "--without-plant"), ("-h", "--help")


def main(args: Sequence[str] | None = None) -> int:
    """Run the composed nodes until SIGINT or SIGTERM.

    Parameters
    ----------
    args : command line, None for that of the process

    Returns
    -------
    int : exit status
    """
    line = list(sys.argv if args is None else args)
    try:
        options = beside_ros_arguments(line)
    except ValueError as error:
        print(f"loop: {error}", file=sys.stderr)
        return 2
    nodes: list[Callable[[], Node]] = [EstimatorNode, ControllerNode]
    if "--with-reference" in options:
        nodes.append(ReferenceNode)
    if "--without-plant" not in options:
        nodes.append(PlantNode)
    left = iter(options)
    try:
        for option in left:
            if option == "--with":
                nodes.append(_node_class(next(left, "nothing")))
            elif option not in (*_OPTIONS, *_HELP):
                raise ValueError(
                    f"found {option}, need some of {', '.join(_OPTIONS)}, --with MODULE:CLASS, or --ros-args"
                )
    except ValueError as error:
        print(f"loop: {error}", file=sys.stderr)
        return 2
    if set(_HELP) & set(options):
        print(inspect.cleandoc(__doc__ or "") + "\n")
    own = set(options) - set(_HELP)
    return run_nodes(*nodes, args=[argument for argument in line if argument not in own])


def _node_class(name: str) -> type[Node]:
    """Return the class of a node; raise a `ValueError` of one line where there is none."""
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except Exception as error:  # a module of somebody else may raise anything while it is imported
        why = " ".join(str(error).split())
        raise ValueError(
            f"--with {name}: cannot be imported ({why}); need MODULE:CLASS of an installed package"
        ) from error
    if not (isinstance(found, type) and issubclass(found, Node)):
        raise ValueError(f"--with {name}: is no class of a node, need a subclass of rclpy.node.Node")
    try:
        inspect.signature(found).bind()
    except TypeError as error:
        raise ValueError(f"--with {name}: {error}, need a class that is made without arguments") from error
    return found


if __name__ == "__main__":
    sys.exit(main())
