"""Start, spin and stop a node the same way in every executable."""

from __future__ import annotations

import gc
import inspect
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Protocol

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

__all__ = ["RigNode", "StopFlag", "fastest_executor", "run_nodes"]

_SPIN_S = 0.05
_USAGE = (
    "nodes take ROS arguments only: --ros-args -p NAME:=VALUE, --params-file FILE, -r __ns:=/NAMESPACE; "
    "`ros2 param describe` tells what each parameter is"
)


class StopFlag:
    """Set by the first SIGINT or SIGTERM; a second one ends the process the ordinary way."""

    def __init__(self) -> None:
        self.is_set = False
        self._before = {
            number: signal.signal(number, self._on_signal) for number in (signal.SIGINT, signal.SIGTERM)
        }

    def set(self) -> None:
        """End the loop as the first signal does."""
        self.is_set = True

    def _on_signal(self, number: int, _frame: object) -> None:
        self.set()
        for each, before in self._before.items():
            signal.signal(each, signal.SIG_DFL if each == signal.SIGTERM else before)


class RigNode(Protocol):
    """What `run_nodes` needs beside `rclpy.node.Node`: a last word before the graph is left."""

    def close(self) -> None:
        """Leave the rig safe and files readable; the node can still publish."""


def fastest_executor(context: rclpy.Context | None = None) -> Executor:
    """Return the executor with the lowest latency that this rclpy has.

    The events executor is stepped with `spin_once` only: its `spin` was seen to hang in relay
    processes with rclpy 7.1.6.
    """
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def run_nodes(*make_nodes: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Compose nodes in one executor, spin until SIGINT or SIGTERM, close them; return the exit status.

    A parameter or argument that cannot be used ends with one line on standard error and status 2.
    """
    program = sys.argv[0].rsplit("/", 1)[-1]
    extra = remove_ros_args(list(sys.argv if args is None else args))[1:]
    if extra:
        texts = [inspect.getdoc(inspect.getmodule(make)) or "" for make in make_nodes]
        asked = set(extra) <= {"-h", "--help"}
        print(
            "\n\n".join([*texts, _USAGE]) if asked else f"{program}: found {' '.join(extra)}; {_USAGE}",
            file=sys.stderr,
        )
        return 0 if asked else 2
    stop = StopFlag()
    nodes: list[Node] = []
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises bare RuntimeError subclasses of its C layer here
        print(f"{program}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    try:
        executor = fastest_executor()
        for make in make_nodes:
            nodes.append(make())
            executor.add_node(nodes[-1])
        # what is loaded by now stays: without this every full collection walks the compiler's objects
        # and stops the loop for a tenth of a second
        gc.collect()
        gc.freeze()
        # told once, not asked after every sample
        rclpy.get_default_context().on_shutdown(stop.set)
        while not stop.is_set:
            executor.spin_once(timeout_sec=_SPIN_S)
        return 0
    except ExternalShutdownException:
        return 0
    except ValueError as error:
        if len(nodes) == len(make_nodes):
            raise
        print(f"{program}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    finally:
        for node in nodes:
            close = getattr(node, "close", None)
            if close is not None and rclpy.ok():
                close()
            node.destroy_node()
        rclpy.try_shutdown()
