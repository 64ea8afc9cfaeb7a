"""Units a rig may write its columns in, and the channels they fit."""

from __future__ import annotations

from dataclasses import dataclass

from vo2_models.recording import (
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
)

__all__ = ["CHANNEL_QUANTITIES", "UNITS", "Unit"]


@dataclass(frozen=True)
class Unit:
    """SI value (degree Celsius for temperatures) = factor * number + offset."""

    quantity: str
    factor: float
    offset: float = 0.0


_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9}
_BASES = {"m": "length", "s": "time", "A": "current", "V": "voltage", "ohm": "resistance", "Ω": "resistance"}

UNITS = {
    **{
        prefix + base: Unit(kind, factor)
        for base, kind in _BASES.items()
        for prefix, factor in _PREFIXES.items()
    },
    "min": Unit("time", 60.0),
    "h": Unit("time", 3600.0),
    "degC": Unit("temperature", 1.0),
    "K": Unit("temperature", 1.0, -273.15),
    "degF": Unit("temperature", 5 / 9, -160 / 9),
    "1": Unit("number", 1.0),
}
"""Name in a map -> unit."""

CHANNEL_QUANTITIES = {
    HEATER_CURRENT: "current",
    RESISTANCE: "resistance",
    TIP_DEFLECTION: "length",
    STAGE_TEMPERATURE: "temperature",
    "heater_voltage": "voltage",
    "sense_current": "current",
    "ambient_temperature": "temperature",
    "laser_on": "number",
}
"""Channels that a map can fill, and what they measure."""
