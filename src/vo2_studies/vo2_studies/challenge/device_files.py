"""Devices beside the presets: drawn nominal rigs, and the device file (`vo2-device/1`) that a laboratory would write.

A drawn rig is a preset whose current, time constant, resistance and deflection are each multiplied by a factor between
1 / `FACTOR` and `FACTOR`, log-uniform; heat gains follow the current so that the operating range still crosses the
transition, which itself is moved by some kelvin. The file tells what is on the data sheet, not what was drawn around it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

from vo2_studies.challenge.devices import Preset, Scales

__all__ = ["device_document", "draw_preset"]

FACTOR = 3.0
"""Largest factor between a drawn rig and its preset."""
TRANSITION_SHIFT = 4.0
"""Largest shift of the transition from the preset's [K]: doping and strain move it further."""


def draw_preset(rng: np.random.Generator, preset: Preset) -> Preset:
    """Draw a rig around `preset`, under an id of its own."""
    current, time, resistance, deflection = np.exp(rng.uniform(-1, 1, 4) * np.log(FACTOR)).tolist()
    shift = float(rng.uniform(-TRANSITION_SHIFT, TRANSITION_SHIFT))
    # a stronger heater reaches the same temperatures with less current
    hot = preset.heating[0] - preset.ambient
    gain = preset.gain / current ** (2 if preset.squared else 1) * (hot + shift) / hot

    def pair(values: tuple[float, float], factor: float) -> tuple[float, float]:
        return (values[0] * factor, values[1] * factor)

    return replace(
        preset,
        name=f"{preset.name}_{rng.integers(16**4):04x}",
        scales=Scales(current, time, deflection),
        current_limits=pair(preset.current_limits, current),
        operating=pair(preset.operating, current),
        gain=gain,
        time_constant=preset.time_constant * time,
        dead_time=preset.dead_time * time,
        sample_period=float(f"{preset.sample_period * time:.3g}"),
        resistance=pair(preset.resistance, resistance),
        deflection=pair(preset.deflection, deflection),
        expansion=pair(preset.expansion, deflection),
        heating=(preset.heating[0] + shift, preset.heating[1]),
        noise_deflection=preset.noise_deflection * deflection,
        noise_current=preset.noise_current * current,
    )


def device_document(preset: Preset) -> dict[str, Any]:
    """Return the content of a rig's device file."""
    low, high = preset.current_limits
    document: dict[str, Any] = {
        "schema": "vo2-device/1",
        "id": preset.name,
        "drive": {
            "channel": HEATER_CURRENT,
            "unit": "A",
            "limits": [low, high],
            "operating": list(preset.operating),
            "safe": 0.0,
        },
        "body": {
            "kind": "first_order",
            "ambient": preset.ambient,
            "linear_gain": 0.0 if preset.squared else preset.gain,
            "square_gain": preset.gain if preset.squared else 0.0,
            "time_constant": preset.time_constant,
            "dead_time": preset.dead_time,
        },
        "responses": {
            RESISTANCE: {
                "unit": "ohm",
                "scale": "log10",
                "range": list(preset.resistance),
                "noise": float(preset.noise_log_resistance) * math.log(10),
            },
            TIP_DEFLECTION: {
                "unit": "m",
                "range": list(preset.deflection),
                "noise": preset.noise_deflection,
            },
        },
        "sampling": {"period": preset.sample_period},
    }
    if preset.has_temperature:
        document["temperature"] = {"channel": STAGE_TEMPERATURE, "noise": preset.noise_temperature}
    return document
