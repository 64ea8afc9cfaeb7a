"""Timers that go on whatever the ROS clock does: in simulated time that one stands until the loop has answered."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

__all__ = ["create_steady_timer", "sharing_timers"]

_shared: dict[float, tuple[Timer, list[Callable[[], object]]]] | None = None


def create_steady_timer(node: Node, period_s: float, callback: Callable[[], object]) -> Timer:
    """Let a node call a function by a clock that neither jumps nor stands, also with `use_sim_time`.

    Parameters
    ----------
    node : that the timer belongs to
    period_s : [s]
    callback : is called every `period_s`

    Returns
    -------
    Timer : of the node, or of the first with this period that was made within `sharing_timers`
    """
    if _shared is None:
        return node.create_timer(period_s, callback, clock=_steady_clock())
    if period_s not in _shared:
        callbacks: list[Callable[[], object]] = []

        def call_all() -> None:
            for each in callbacks:
                each()

        _shared[period_s] = (node.create_timer(period_s, call_all, clock=_steady_clock()), callbacks)
    timer, others = _shared[period_s]
    others.append(callback)
    return timer


@contextmanager
def sharing_timers() -> Iterator[None]:
    """Let the nodes made in this context share one timer for each period: for many alike that begin and end together.

    The events executor goes through all timers whenever one is due, and calls some anew before others were called once:
    of 50 devices with three timers each, it kept half of the periods of 0.1 s, with a twentieth of a processor in use.

    Yields
    ------
    None : nothing; the timers end with the nodes
    """
    global _shared
    _shared = {}
    try:
        yield
    finally:
        _shared = None


@cache
def _steady_clock() -> Clock:
    """Return one clock for all timers: an executor has a thread for each clock."""
    return Clock(clock_type=ClockType.STEADY_TIME)
