"""What every node knows of a device: its presets, its operating point, and the `model.*` parameters of its file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from vo2_models.parameters import Parameter

__all__ = ["PRESETS", "OperatingPoint", "model_parameters", "operating_point"]


@dataclass(frozen=True)
class OperatingPoint:
    """What a node needs of a preset.

    Attributes
    ----------
    rate_hz : usual sampling rate
    lower_a, upper_a : range of the operating current [A]
    cold_a, hot_a : its ends by temperature [A]: below and above both transitions
    settle_s : time after which a held current is quasi-static [s]
    deflection_range_m : what "per cent of range" divides by [m]
    """

    rate_hz: float
    lower_a: float
    upper_a: float
    cold_a: float
    hot_a: float
    settle_s: float
    deflection_range_m: float


_POINTS = {
    "integrated": OperatingPoint(1000.0, 3.68e-3, 8.49e-3, 3.68e-3, 8.49e-3, 0.01, 57.03e-6),
    "peltier": OperatingPoint(8.0, -1.15, 0.05, 0.05, -1.15, 125.0, 70e-6),
}
PRESETS = tuple(_POINTS)


def operating_point(preset: str) -> OperatingPoint:
    """Return the operating point of a preset; raise `ValueError` naming the known ones."""
    if preset not in _POINTS:
        raise ValueError(f"preset: found {preset!r}, need one of {', '.join(PRESETS)}")
    return _POINTS[preset]


@lru_cache(maxsize=1)
def model_parameters() -> tuple[Parameter, ...]:
    """Return the records of everything a model file may hold, in every section."""
    return ()
