"""Topic names, channel names and quality of service, as recordings and clients rely on them."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

__all__ = [
    "CLOCK",
    "COMMAND",
    "COMMANDER",
    "COMMAND_CHANNELS",
    "DEFAULT_NAMESPACE",
    "DIAGNOSTICS",
    "EMERGENCY_STOP",
    "EMERGENCY_STOP_QOS",
    "ESTIMATE",
    "ESTIMATE_CHANNELS",
    "LATCHED_QOS",
    "LOCKSTEP_QOS",
    "MEASUREMENT",
    "ONE_DEVICE",
    "OVERRIDABLE_INPUT",
    "READ_QOS",
    "REFERENCE",
    "REFERENCE_CHANNELS",
    "SAMPLE_QOS",
]

DEFAULT_NAMESPACE = "/vo2"

# Relative, so that a namespace moves a whole loop.
COMMAND = "command"
MEASUREMENT = "measurement"
ESTIMATE = "estimate"
REFERENCE = "reference"
EMERGENCY_STOP = "emergency_stop"
DIAGNOSTICS = "/diagnostics"
CLOCK = "/clock"

ONE_DEVICE = {
    MEASUREMENT: "let one device publish, or give each a namespace; one that was killed counts for 20 s more"
}
"""What is told where two nodes are the device: a controller would answer the samples of both."""

COMMAND_CHANNELS = ("heater_current",)
COMMANDER = "commander"
"""Wall time: channel of a command with the number of the node that commands, so that the plant can listen to one."""
ESTIMATE_CHANNELS = ("tip_deflection", "temperature_surrogate", "tip_deflection_bound")
REFERENCE_CHANNELS = ("tip_deflection",)


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


SAMPLE_QOS = _reliable(100)
READ_QOS = _reliable(20_000)
"""For subscriptions: a node that is not part of a lockstep loop, or is busy for a moment, loses no sample."""
LOCKSTEP_QOS = QoSProfile(
    history=HistoryPolicy.KEEP_ALL,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Of the plant in lockstep: a loop that runs faster than a recorder can take waits for it, as no time passes meanwhile.
How many samples may be on their way the Fast DDS profile says."""
LATCHED_QOS = _reliable(100, DurabilityPolicy.TRANSIENT_LOCAL)
EMERGENCY_STOP_QOS = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
"""Of each publisher the last word only."""
OVERRIDABLE_INPUT = QoSOverridingOptions(
    (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)
)
"""Declares the parameters `qos_overrides./TOPIC.subscription.reliability`, `.depth`, `.history` and `.durability` of an input.

rclpy writes them into the profile that it is given: give it a copy, or they hold for every node and publisher of the process."""
