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
