"""What a stored topic is: name, type, quality of service, type hash."""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

__all__ = ["JOINT_STATE", "Channel", "message_class"]

JOINT_STATE = "sensor_msgs/msg/JointState"


class Channel(NamedTuple):
    """One topic as a storage file describes it; `qos` is the YAML text of its offered QoS profiles."""

    topic: str
    msgtype: str
    qos: str = ""
    type_hash: str = ""


def message_class(msgtype: str) -> Any:
    """Return the class of the message type `msgtype`; raise `ValueError` where it is not installed."""
    package, _, name = msgtype.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise ValueError(f"its type {msgtype} is not installed here") from None
