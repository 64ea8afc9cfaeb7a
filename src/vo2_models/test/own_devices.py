"""Devices of a file that several tests record on."""

from vo2_models.device.description import described

STACK = described(
    {
        "schema": "vo2-device/1",
        "id": "stack",
        "drive": {"channel": "drive_voltage", "unit": "V", "limits": [0.0, 60.0]},
        "responses": {"extension": {"unit": "m"}},
    },
    "stack",
)
"""A piezo stack: a voltage, an extension, no body."""
STACK_TO_10_V = described(
    {
        "schema": "vo2-device/1",
        "id": "stack",
        "drive": {"channel": "volts", "unit": "V", "limits": [-0.5, 10.5], "operating": [0.0, 10.0]},
        "body": {"kind": "none"},
        "responses": {"stroke": {"unit": "m"}},
    },
    "stack",
)
"""Another one, whose file says over which part of its limits it works."""
