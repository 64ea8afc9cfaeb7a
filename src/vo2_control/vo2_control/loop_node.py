"""`loop`: plant, estimator and controller composed in one process and one executor, for fast loops.

The same nodes, topics and parameters as in separate processes; `--with-reference` adds the reference node,
`--without-plant` leaves the plant out, for a real device that speaks the same topics.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Sequence

from rclpy.node import Node
from vo2_estimation.estimator_node import EstimatorNode
from vo2_interface.executable import beside_ros_arguments, run_nodes
from vo2_plant_sim.plant_node import PlantNode

from vo2_control.controller_node import ControllerNode
from vo2_control.reference_node import ReferenceNode

__all__ = ["main"]

_OPTIONS = ("--with-reference", "--without-plant")


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
    unknown = [option for option in options if option not in (*_OPTIONS, "-h", "--help")]
    if unknown:
        print(
            f"loop: found {' '.join(unknown)}, need some of {', '.join(_OPTIONS)} or --ros-args",
            file=sys.stderr,
        )
        return 2
    if {"-h", "--help"} & set(options):
        print(inspect.cleandoc(__doc__ or "") + "\n")
    nodes: list[Callable[[], Node]] = [EstimatorNode, ControllerNode]
    if "--with-reference" in options:
        nodes.append(ReferenceNode)
    if "--without-plant" not in options:
        nodes.append(PlantNode)
    return run_nodes(*nodes, args=[argument for argument in line if argument not in _OPTIONS])


if __name__ == "__main__":
    sys.exit(main())
