"""Timers that go on whatever the ROS clock does: in simulated time that one stands until the loop has answered."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

__all__ = ["create_steady_timer"]


def create_steady_timer(node: Node, period_s: float, callback: Callable[[], object]) -> None:
    """Let a node call a function by a clock that neither jumps nor stands, also with `use_sim_time`.

    Parameters
    ----------
    node : that the timer belongs to
    period_s : [s]
    callback : is called every `period_s`
    """
    node.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))
