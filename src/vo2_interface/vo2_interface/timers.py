"""Timers that go on whatever the ROS clock does: in simulated time that one stands until the loop has answered."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

__all__ = ["create_steady_timer"]


def create_steady_timer(node: Node, period_s: float, callback: Callable[[], object]) -> Timer:
    """Let a node call a function by a clock that neither jumps nor stands, also with `use_sim_time`.

    Parameters
    ----------
    node : that the timer belongs to
    period_s : [s]
    callback : is called every `period_s`

    Returns
    -------
    Timer : of the node
    """
    return node.create_timer(period_s, callback, clock=_steady_clock())


@cache
def _steady_clock() -> Clock:
    """Return one clock for all timers: an executor has a thread for each clock."""
    return Clock(clock_type=ClockType.STEADY_TIME)
