"""What a stored topic is: name, type, quality of service, type hash."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["JOINT_STATE", "Channel"]

JOINT_STATE = "sensor_msgs/msg/JointState"


class Channel(NamedTuple):
    """One topic as a storage file describes it; `qos` is the YAML text of its offered QoS profiles."""

    topic: str
    msgtype: str
    qos: str = ""
    type_hash: str = ""
