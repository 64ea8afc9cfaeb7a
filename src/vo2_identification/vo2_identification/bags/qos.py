"""Quality of service as bags store it, and the contract's default of each topic."""

from __future__ import annotations

import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9

__all__ = ["contract_qos", "profiles", "profiles_text"]

_INFINITE = QosTime(9223372036, 854775807)  # RMW_DURATION_INFINITE


def contract_qos(topic: str) -> Qos:
    """Return reliable, keep last 100, volatile; transient local for a reference.

    Parameters
    ----------
    topic : name
    """
    latched = topic.rsplit("/", 1)[-1] == "reference"
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=100,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=_INFINITE,
        lifespan=_INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_INFINITE,
        avoid_ros_namespace_conventions=False,
    )


def profiles(qos: Qos) -> list[dict[str, object]]:
    """Return `offered_qos_profiles` as metadata.yaml of version 9 holds it.

    Parameters
    ----------
    qos : of one publisher
    """
    return [dict(profile) for profile in dump_qos_v9([qos])]


def profiles_text(qos: Qos) -> str:
    """Return `offered_qos_profiles` as the storage files hold it: the same as YAML text.

    Parameters
    ----------
    qos : of one publisher
    """
    return str(yaml.safe_dump(profiles(qos), sort_keys=False)).strip()
