"""Start, spin and stop a node the same way in every executable."""

from __future__ import annotations

import faulthandler
import gc
import inspect
import math
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import redirect_stdout
from difflib import get_close_matches
from io import StringIO
from itertools import pairwise
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any, Protocol

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from vo2_interface.one_host import missing_settings
from vo2_interface.timers import create_steady_timer
from vo2_interface.usage import ARGUMENTS, usage

__all__ = [
    "RigNode",
    "StopFlag",
    "beside_ros_arguments",
    "fastest_executor",
    "join_graph",
    "leave_graph",
    "node_main",
    "run_nodes",
]

_SPIN_S = 0.05
_ONE_END_S = 2.0
_PATIENCE_S = 1.0
_LEAVE_S = 6.0
_STEP_LOOK_S = 0.02
_LEAST_STEP_S = 0.005
_ORDINARY: dict[int, Callable[[int, FrameType | None], Any] | signal.Handlers] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}
"""What Python does on a signal, whatever handler was there as a node began to load."""
_SET_PARAMETER = re.compile(r"(?:[^:=]+:)?([^:=]+):=")
_OF_ROS = ("qos_overrides.", "use_sim_time", "start_type_description_service")
_SOURCE_LINE = re.compile(r",? at /[^ ,]*:\d+")
_BAD_FILE = re.compile(r"params file: '--params-file (.*?)'\. Error: (.*?)(?:, at /.*)?$")


class StopFlag:
    """Set by the first SIGINT or SIGTERM; one that comes more than two seconds later acts the ordinary way.

    Whoever presses Ctrl-C twice, or tells a launch file and its processes both, means one end: a second signal must
    not break the first one's work.

    Parameters
    ----------
    stuck : is called in a thread of its own where the first signal has not been obeyed for a second, since the main
        thread is in the compiler or in a long computation, and ends the process; None to wait for as long as it takes
    """

    def __init__(self, stuck: Callable[[], None] | None = None) -> None:
        self.is_set = False
        self._first_s = math.inf
        self._obeyed = threading.Event()
        for number in _ORDINARY:
            signal.signal(number, self._on_signal)
        if stuck is not None:
            self._watch(stuck)

    def set(self) -> None:
        """End the loop as the first signal does."""
        self.is_set = True

    def obeyed(self) -> None:
        """Tell that the end has begun, in order; after a signal it is not disturbed by more of them.

        Handlers would not do: Python takes them away while it shuts down, and the next signal would kill it.
        """
        self._obeyed.set()
        if math.isfinite(self._first_s):
            for each in _ORDINARY:
                signal.signal(each, signal.SIG_IGN)

    def _on_signal(self, number: int, _frame: object) -> None:
        self.set()
        now = time.monotonic()
        self._first_s = min(self._first_s, now)
        if now - self._first_s > _ONE_END_S:
            for each, handler in _ORDINARY.items():
                signal.signal(each, handler)
            signal.raise_signal(number)

    def _watch(self, stuck: Callable[[], None]) -> None:
        """Hear signals beside the main thread: Python calls a handler only once that one returns to Python."""
        hears, tells = os.pipe()
        os.set_blocking(tells, False)
        signal.set_wakeup_fd(tells, warn_on_full_buffer=False)

        def watch() -> None:
            while True:
                heard = os.read(hears, 1)[0]
                if heard in _ORDINARY and not self._obeyed.wait(_PATIENCE_S):
                    stuck()

        threading.Thread(target=watch, daemon=True).start()


class RigNode(Protocol):
    """What `run_nodes` needs beside `rclpy.node.Node`: a last word before the graph is left."""

    def close(self) -> None:
        """Leave the rig safe and files readable; the node can still publish."""


def beside_ros_arguments(line: Sequence[str]) -> list[str]:
    """Return what stands on a command line (program first) beside the ROS arguments.

    Raises
    ------
    ValueError : ROS arguments that cannot be used, such as a parameter file that is not there; one line.
    """
    try:
        return list(remove_ros_args(list(line))[1:])
    except Exception as error:  # rclpy raises bare RuntimeError subclasses of its C layer here
        text = " ".join(str(error).split())
        if found := _BAD_FILE.search(text):
            path, reason = found.groups()
            there = Path(path).is_file()
            why = f"cannot be read as a ROS parameter file ({reason})" if there else "found no such file"
            raise ValueError(
                f"--params-file {path}: {why}; give one that `fit` or `identifier` wrote"
            ) from error
        raise ValueError(text) from error


def join_graph(args: Sequence[str] | None = None) -> None:
    """Initialise rclpy with the settings of `one_host`, whatever shell this process was started from.

    Parameters
    ----------
    args : command line with the program first, None for `sys.argv`

    Raises
    ------
    ValueError : ROS arguments that cannot be used; one line.
    """
    # read by rcl and by Fast DDS when the first participant is made
    os.environ.update(missing_settings())
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy raises bare RuntimeErrors of its C layer here
        raise ValueError(" ".join(str(error).split())) from error


def fastest_executor(context: rclpy.Context | None = None) -> Executor:
    """Return the executor with the lowest latency that this rclpy has.

    The events executor is stepped with `spin_once` only: its `spin` was seen to hang in relay
    processes with rclpy 7.1.6.

    Parameters
    ----------
    context : of the nodes, None for the default one
    """
    try:
        from rclpy.experimental import EventsExecutor, events_executor
    except ImportError:
        return SingleThreadedExecutor(context=context)
    if faulthandler.is_enabled():
        # every new executor would send the stacks of a crash to sys.stderr instead, which pytest captures and loses
        setattr(events_executor, "faulthandler", SimpleNamespace(enable=lambda: None))  # noqa: B010  # not declared
    return EventsExecutor(context=context)


def leave_graph(
    executor: Executor | None, nodes: Iterable[Node], context: rclpy.Context | None = None
) -> None:
    """Stop spinning, destroy the nodes, leave the graph: in this order, with everything else already done.

    A process that does not get on with that for six seconds is ended with status 1, and the threads' stacks are written
    to standard error; fifty nodes may take longer together, as each tells the graph of all that are left. Fast DDS 2.14,
    seen once in some hundred processes that ended together: to destroy a participant it spins, with Python's lock, until a
    discovery callback is over, and the callback waits for a mutex that the spinning never leaves long enough.

    Parameters
    ----------
    executor : to shut down, if there is one
    nodes : to destroy
    context : to shut down
    """

    def get_on() -> None:
        faulthandler.dump_traceback_later(_LEAVE_S, exit=True, file=sys.__stderr__ or 2)

    get_on()
    try:
        # while its nodes are alive: an executor that outlives them destroys what is left of them
        if executor is not None:
            executor.shutdown()
        for node in nodes:
            get_on()
            node.destroy_node()
        get_on()
        rclpy.try_shutdown(context=context)
    finally:
        faulthandler.cancel_dump_traceback_later()


def run_nodes(*make_nodes: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Compose nodes in one executor, spin until SIGINT or SIGTERM, close them; return the exit status.

    A parameter or argument that cannot be used, or a graph that does not let the node in, ends with one line on standard
    error and status 2; hardware that is not there with one and status 1.

    Parameters
    ----------
    make_nodes : called one after the other once rclpy runs
    args : command line, None for that of the process
    """
    program = sys.argv[0].rsplit("/", 1)[-1]
    try:
        extra = beside_ros_arguments(list(sys.argv if args is None else args))
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    if extra:
        if set(extra) <= {"-h", "--help"}:
            print("\n\n".join([*(usage(inspect.getmodule(make)) for make in make_nodes), ARGUMENTS]))
            return 0
        print(f"{program}: found {' '.join(extra)}; {ARGUMENTS}", file=sys.stderr)
        return 2
    nodes: list[Node] = []
    closing, closed = threading.Lock(), threading.Event()

    def close_once() -> None:
        with closing:
            if not closed.is_set():
                _close(nodes)
            closed.set()

    def leave_at_once() -> None:
        close_once()
        os._exit(0)

    stop = StopFlag(leave_at_once)
    executor: Executor | None = None
    try:
        join_graph(args)
    except ValueError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 2
    try:
        executor = fastest_executor()
        for make in make_nodes:
            if stop.is_set:
                return 0
            nodes.append(make())
            executor.add_node(nodes[-1])
        if unknown := _unknown_parameter(list(sys.argv if args is None else args), nodes):
            print(f"{program}: {unknown}", file=sys.stderr)
            return 2
        _outlive_steps_of_the_clock(executor, nodes[0])
        # the first turn takes the timers over, and prints a warning for each beyond the eighth
        with redirect_stdout(StringIO()):
            executor.spin_once(timeout_sec=0.0)
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
        # what is not there may come: `supervise` starts such a node again
        return 1 if isinstance(error, OSError) else 2
    except rclpy_implementation.RCLError as error:
        if len(nodes) == len(make_nodes):
            raise
        # as where security is enforced without keys, or without a plug-in
        why = _SOURCE_LINE.sub("", " ".join(str(error).split()))
        print(f"{program}: cannot join the graph: {why}", file=sys.stderr)
        return 2
    finally:
        stop.obeyed()
        close_once()
        leave_graph(executor, nodes)


def _unknown_parameter(line: Sequence[str], nodes: Sequence[Node]) -> str:
    """What is wrong with a parameter that the command line sets and no node has: ROS passes over it, a limit too; else nothing.

    Files are not judged: one file may serve the nodes of several processes.
    """
    known = [name for node in nodes for name in node.get_parameters_by_prefix("")]
    for option, text in pairwise(line):
        found = _SET_PARAMETER.match(text)
        if option in ("-p", "--param") and found and not (found[1] in known or found[1].startswith(_OF_ROS)):
            near = get_close_matches(found[1], known, n=1)
            hint = f"did you mean {near[0]}?" if near else "--help lists what there is"
            return f"{found[1]}: no such parameter; {hint}"
    return ""


def _outlive_steps_of_the_clock(executor: Executor, node: Node) -> None:
    """Wake the executor and its timers once the host's time of day was set back.

    The wheels are built for C libraries that wait by the time of day alone, whatever clock is asked for: what waits
    for a hundredth of a second as the clock is set back by an hour would wait for that hour, with the heater on.
    """
    timer = create_steady_timer(node, 3600.0, lambda: None)

    def watch() -> None:
        before = time.time() - time.monotonic()
        while True:
            time.sleep(_STEP_LOOK_S)
            now = time.time() - time.monotonic()
            if now < before - _LEAST_STEP_S:
                try:
                    timer.reset()  # the timers' thread looks anew at when the next is due
                    executor.wake()
                except InvalidHandle:
                    return  # the node has left the graph
            before = now

    threading.Thread(target=watch, daemon=True).start()


def node_main(make_node: Callable[[], Node]) -> Callable[..., int]:
    """Return the `main` of an executable that runs one node.

    Parameters
    ----------
    make_node : see `run_nodes`

    Returns
    -------
    callable : takes the command line, None for that of the process, and returns the exit status
    """

    def main(args: Sequence[str] | None = None) -> int:
        return run_nodes(make_node, args=args)

    return main


def _close(nodes: Iterable[Node]) -> None:
    for node in nodes:
        close = getattr(node, "close", None)
        if close is not None and rclpy.ok():
            close()
