"""What an effect is: a named term with its equation, parameters and reach."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import Coefficient, Sensor, sensor_index
from vo2_models.parameters import Parameter
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = [
    "ALL",
    "CHOICE",
    "FILM",
    "HEAT",
    "PHASE",
    "Apply",
    "Effect",
    "Stage",
    "constant_of",
    "scaled_by_device",
    "setting",
]

Stage = Literal["driver", "thermal", "transition", "terminals", "structure", "sensor"]
Floats = NDArray[np.float64]
Apply = Callable[[Floats, Mapping[str, float], str, str], None]
"""(coefficient vector to change, parameter values, device, signal) -> None."""

FILM = (RESISTANCE, TIP_DEFLECTION)
"""What a change of the film's temperature or phase reaches."""
HEAT = (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
"""What a change of the heated body's temperature reaches."""
ALL = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
"""What a change of the current itself reaches."""


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes
    ----------
    id : name in the contract
    stage : part of the chain it belongs to
    parameters : name, unit, physical bounds and neutral value (`default`) of each parameter
    apply : writes the parameters into a coefficient vector
    channels : channels it can reach; for a signal effect the signals it can sit on, of which it reaches one
    signal : whether it sits on one channel, named with "signal"
    presets : devices on which it can occur
    typical : preset, or "preset:signal", -> parameter -> range of clearly visible magnitudes, for demonstrations
    fixed : parameters that an excitation cannot separate from the others; a fit leaves them at their default
    straight : whether what it does grows in proportion to the time: what bends in time is something else
    equation : the added term
    excitation : what a recording must contain to show it
    source : where the term comes from
    statement : one paragraph in words
    """

    id: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    apply: Apply
    channels: tuple[str, ...]
    typical: Mapping[str, Mapping[str, tuple[float, float]]] = field(hash=False)
    equation: str
    excitation: str
    source: str
    statement: str
    signal: bool = False
    presets: tuple[str, ...] = ("integrated", "peltier")
    fixed: tuple[str, ...] = ()
    straight: bool = False

    def neutral(self) -> dict[str, float]:
        """Return the parameter values at which the effect is off."""
        return {parameter.name: float(parameter.default) for parameter in self.parameters}  # type: ignore[arg-type]

    def reaches(self, device: str, signal: str = "") -> tuple[str, ...]:
        """Return the channels the effect reaches on a device: the signal alone for a signal effect."""
        return tuple(name for name in self.reaches_any(device) if not self.signal or name == signal)

    def signals(self, device: str) -> tuple[str, ...]:
        """Return the channels of a device that the effect can sit on; one empty name for an effect without signal."""
        return tuple(self.reaches_any(device)) if self.signal else ("",)

    def reaches_any(self, device: str) -> tuple[str, ...]:
        """Return the channels of a device that the effect can reach with any signal."""
        from vo2_models.device.description import preset

        return tuple(name for name in self.channels if name in preset(device).channels)

    def draw(self, device: str, rng: np.random.Generator) -> dict[str, float | str]:
        """Draw a clearly visible instance (values log-uniform over `typical`), with its signal where it has one."""
        signal = str(rng.choice(self.signals(device)))
        ranges = self.typical.get(f"{device}:{signal}") or self.typical[device]
        values: dict[str, float | str] = {
            name: float(np.exp(rng.uniform(np.log(low), np.log(high))))
            for name, (low, high) in ranges.items()
        }
        return {**values, "signal": signal} if signal else values

    def complete(self, values: Mapping[str, float | str]) -> tuple[dict[str, float], str]:
        """Return all parameter values, checked and filled up with neutral ones, and the signal.

        Raises
        ------
        ValueError : unknown parameter, value out of range, or a missing or needless signal.
        """
        given = dict(values)
        signal = str(given.pop("signal", ""))
        if self.signal and signal not in self.channels:
            raise ValueError(f"{self.id}: found signal {signal!r}, need one of {', '.join(self.channels)}")
        if signal and not self.signal:
            raise ValueError(
                f"{self.id}: found a signal ({signal}), but the effect sits on no single channel"
            )
        known = {parameter.name: parameter for parameter in self.parameters}
        for name in given:
            if name not in known:
                raise ValueError(f"{self.id}: found parameter {name!r}, need one of {', '.join(known)}")
        complete = self.neutral()
        for name, value in given.items():
            try:
                complete[name] = float(known[name].check(float(value)))  # type: ignore[arg-type]
            except ValueError as error:
                raise ValueError(f"{self.id}.{error}") from error
        return complete, signal


def setting(**coefficients: Coefficient | Sensor) -> Apply:
    """Return an `apply` that writes each named parameter to its coefficient (of the signal's sensor)."""

    def apply(c: Floats, values: Mapping[str, float], device: str, signal: str) -> None:
        for name, index in coefficients.items():
            place = sensor_index(signal, index) if isinstance(index, Sensor) else int(index)
            c[place] = values[name]

    return apply


def scaled_by_device(name: str, places: Mapping[str, Coefficient]) -> Apply:
    """Return an `apply` that writes the parameter `name` to the coefficient that the device has for it."""

    def apply(c: Floats, values: Mapping[str, float], device: str, signal: str) -> None:
        c[places[device]] = values[name]

    return apply


def constant_of(
    name: str, default: float, unit: str, description: str, lower: float, upper: float
) -> Parameter:
    """Return a `Parameter` of an effect; `default` is its neutral value."""
    return Parameter(name, float(default), unit, description, float(lower), float(upper))


CHOICE = "choice"
"""Unit of a parameter that is one of two alternatives, 0 or 1: tried both ways, never fitted."""
PHASE = constant_of(
    "phase", 0, CHOICE, "transition whose fraction s counts: 0 the structural one, 1 the metallic one", 0, 1
)
