"""What a concealed effect is: an id, the presets it applies to, a random draw, and how it enters a plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

from vo2_studies.challenge.devices import Device, Preset
from vo2_studies.challenge.rig import Plan

__all__ = [
    "ANY",
    "INTEGRATED",
    "PELTIER",
    "ConcealedEffect",
    "Context",
    "Drawn",
    "either_sign",
    "log_uniform",
]

INTEGRATED = ("integrated",)
PELTIER = ("peltier",)
ANY = ("integrated", "peltier")


@dataclass(frozen=True)
class Context:
    """What a draw may depend on: randomness, the device, and the recording's duration [s]."""

    rng: np.random.Generator
    device: Device
    duration: float

    @property
    def preset(self) -> Preset:
        return self.device.preset

    @property
    def quick(self) -> bool:
        """Whether the device answers within a few samples (milliseconds) rather than many (half a minute)."""
        return self.preset.squared

    def seconds(self, quick: tuple[float, float], slow: tuple[float, float]) -> float:
        """Draw a time [s] log-uniformly from the range of the preset that this rig is drawn around."""
        return log_uniform(self.rng, *(quick if self.quick else slow)) * self.preset.scales.time

    def amperes(self, quick: tuple[float, float], slow: tuple[float, float]) -> float:
        """Draw a current [A] likewise."""
        return log_uniform(self.rng, *(quick if self.quick else slow)) * self.preset.scales.current

    def place(self, share: float) -> float:
        """Return the nominal temperature [degC] at `share` of the operating range."""
        low, high = self.device.cold_temperature, self.device.hot_temperature
        return low + share * (high - low)

    def signals(self) -> tuple[str, ...]:
        """Return the sensor channels of the device."""
        both = (RESISTANCE, TIP_DEFLECTION)
        return (*both, STAGE_TEMPERATURE) if self.preset.has_temperature else both


@dataclass(frozen=True)
class ConcealedEffect:
    """One kind of effect.

    Attributes
    ----------
    id : the contract's id, or a name outside the catalogue
    presets : preset ids it applies to
    draw : (context, and the channel if per_signal) -> parameters, name -> (value, unit)
    apply : (plan, values, context) puts the effect into the plan; with the key "signal" in `Drawn` for sensors
    neutral : parameter values with which it vanishes
    driver : acts between command and current (a logged shunt current then shows it directly)
    per_signal : acts on one sensor channel, drawn at random
    needs_set_value : cannot be seen where the rig logs the true current
    form : which of the forms of this physics; "catalogue" where a simulation would first write it like this
    siblings : other names that are right for this form too
    """

    id: str
    presets: tuple[str, ...]
    draw: Callable[..., dict[str, tuple[float, str]]]
    apply: Callable[..., None]
    neutral: dict[str, float] = field(default_factory=dict)
    driver: bool = False
    per_signal: bool = False
    needs_set_value: bool = False
    form: str = "catalogue"
    siblings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Drawn:
    """One effect with its drawn parameters, name -> (value, unit), and the channel of a sensor effect."""

    effect: ConcealedEffect
    parameters: dict[str, tuple[float, str]]
    signal: str | None = None

    @property
    def values(self) -> dict[str, float]:
        return {name: value for name, (value, _) in self.parameters.items()}

    def into(self, plan: Plan, context: Context, **override: float) -> None:
        """Put the effect into `plan`, with single parameter values overridden."""
        values = self.values | override
        if self.effect.per_signal:
            self.effect.apply(plan, values, context, self.signal)
        else:
            self.effect.apply(plan, values, context)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw log-uniformly from low to high, both positive."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def either_sign(rng: np.random.Generator, value: float) -> float:
    """Return `value` with a random sign."""
    return value if rng.random() < 0.5 else -value
