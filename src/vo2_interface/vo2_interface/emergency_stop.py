"""Emergency stop: one topic and one service, which every node that commands or drives obeys within one sample."""

from __future__ import annotations

import math
import time
from copy import copy
from typing import Literal

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Bool
from std_srvs.srv import SetBool

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.topics import EMERGENCY_STOP, EMERGENCY_STOP_QOS, OVERRIDABLE_INPUT

__all__ = ["EmergencyStop"]

_MEET_S = 1.0
"""Time in which the last words of all publishers reach a node that has just started [s]."""


class EmergencyStop:
    """Whether the graph is stopped, as one node sees it.

    `true` on the topic `emergency_stop` stops, `false` releases; the service `~/emergency_stop` of any node says it on
    the topic, so that all nodes follow. A node that hears a stop says it again: who speaks once, such as
    `ros2 topic pub --once`, may be gone before discovery has brought the word to more than one node. A stop is heard from
    publishers of any quality of service, a release from reliable, latched ones only (as the services and `ros2 topic pub`
    are), unless `qos_overrides./TOPIC.subscription.*` says otherwise.

    The topic is latched: a node that starts while the graph is stopped stops with it. Such a node hears the last word
    of each publisher in any order. So for its first second a `true` stands whatever else it hears, and a node that
    has said `true` takes that back once it hears a `false`.

    Parameters
    ----------
    node : that obeys: it commands or applies the safe current while `active`
    diagnostics : where the state is told, as `emergency stop`

    Attributes
    ----------
    active : whether the graph is stopped
    """

    def __init__(self, node: Node, diagnostics: Diagnostics) -> None:
        self.active = False
        # our own `true`: not heard back yet, or standing on the topic for who comes late
        self._own: Literal["none", "pending", "standing"] = "none"
        self._diagnostics = diagnostics
        self._started_s = time.monotonic()
        self._publisher = node.create_publisher(Bool, EMERGENCY_STOP, EMERGENCY_STOP_QOS)
        # a publisher that latches nothing is heard by the second one: that it does not suit the first is no news
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        node.create_subscription(
            Bool,
            EMERGENCY_STOP,
            self._on_word,
            copy(EMERGENCY_STOP_QOS),  # an override is written into it
            event_callbacks=quiet,
            qos_overriding_options=OVERRIDABLE_INPUT,
        )
        node.create_subscription(Bool, EMERGENCY_STOP, self._on_any_word, qos_profile_sensor_data)
        node.create_service(SetBool, "~/emergency_stop", self._on_call)

    def _on_any_word(self, message: Bool) -> None:
        if message.data:
            self._stop_with_others()

    def _on_word(self, message: Bool) -> None:
        if message.data:
            if self._own == "pending":
                self._own = "standing"
            self._stop_with_others()
        # what was said before our own `true`, or may have been said before another's
        elif self._own != "pending" and time.monotonic() - self._started_s >= _MEET_S:
            if self._own == "standing":
                self._own = "none"
                self._publisher.publish(Bool(data=False))
            self._set(False)

    def _stop_with_others(self) -> None:
        if not self.active:
            self._own = "pending"
            self._set(True)
            self._publisher.publish(Bool(data=True))

    def _on_call(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._own = "pending"
            self._set(True)
        else:
            self._own = "none"
            self._started_s = -math.inf  # who calls knows of the stop
        self._publisher.publish(Bool(data=request.data))
        response.success = True
        response.message = "stopped: safe current" if request.data else "released"
        return response

    def _set(self, stop: bool) -> None:
        if stop == self.active:
            return
        self.active = stop
        text = "stopped: safe current until ~/emergency_stop is called with false" if stop else "released"
        self._diagnostics.report("emergency stop", "error" if stop else "ok", text)
