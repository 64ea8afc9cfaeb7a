"""The fitted simulation of a device: what `fit` writes and plant, estimator, controller and diagnosis load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from vo2_models.device.coefficients import CHANNELS, Coefficient, Sensor, sensor_index
from vo2_models.device.description import DeviceDescription, DeviceParameter, preset
from vo2_models.device.law_step import pack_law
from vo2_models.device.simulation import PLAYS, Simulation, nominal_coefficients
from vo2_models.device.stepper import Stepper
from vo2_models.effects import effects as catalogue
from vo2_models.effects.catalogue import VARIABLE
from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.laws import bank_parameters, law_from_parameters, law_parameters
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.model_file import load_model_parameters, save_model_parameters
from vo2_models.parameters import Parameter, Value
from vo2_models.recording import RESISTANCE, Recording

__all__ = ["PARAMETERS", "DeviceModel", "SensorModel", "fitted_names"]

SCALARS = {
    "driver.dead_time": ("s", "dead time between current and heat", 0.0, 1e6),
    "driver.held": (
        "1",
        "1 where the drive of a device without heat is held over a sample, 0 where it goes straight",
        0.0,
        1.0,
    ),
    "thermal.ambient": ("degC", "temperature without current", -1e9, 1e9),
    "thermal.linear_gain": ("K/A", "steady temperature rise per current", -1e12, 1e12),
    "thermal.square_gain": ("K/A^2", "steady temperature rise per squared current", 0.0, 1e15),
    "thermal.time_constant": ("s", "thermal time constant", 1e-9, 1e9),
    "thermal.power_gain": (
        "K/W",
        "steady temperature rise per electrical power in the film itself",
        0.0,
        1e15,
    ),
    "thermal.slow_share": ("1", "part of the temperature rise that arrives through a slower lag", 0.0, 1.0),
    "thermal.slow_time_constant": ("s", "time constant of the slower lag", 1e-9, 1e9),
}
"""Scalar parameters of the sections driver and thermal: unit, meaning, range. `model.` goes before."""
_COEFFICIENT = {
    "driver.dead_time": Coefficient.DEAD_TIME,
    "driver.held": Coefficient.HELD,
    "thermal.ambient": Coefficient.AMBIENT,
    "thermal.linear_gain": Coefficient.LINEAR_GAIN,
    "thermal.square_gain": Coefficient.SQUARE_GAIN,
    "thermal.time_constant": Coefficient.TIME_CONSTANT,
    "thermal.power_gain": Coefficient.POWER_GAIN,
    "thermal.slow_share": Coefficient.SLOW_SHARE,
    "thermal.slow_time_constant": Coefficient.SLOW_TIME,
}
_NEUTRAL_LEFT_OUT = {
    "driver.held": ("driver.held",),
    "thermal.power_gain": ("thermal.power_gain",),
    "thermal.slow_share": ("thermal.slow_share", "thermal.slow_time_constant"),
}
"""Scalar that is 0 on most devices -> what a model file then leaves out."""
_BANKS = ("resistance", "deflection")
EFFECTS = "model.effects."
"""Begins the names of the parameters of effects."""
_OWN = tuple(f"model.{section}." for section in (*_BANKS, "driver", "thermal", "sensors", "uncertainty"))
"""Begin names that belong to this section of a model file alone."""


@dataclass(frozen=True)
class SensorModel:
    """Noise of one channel and what the fit leaves over.

    Attributes
    ----------
    noise : standard deviation of the sensor's noise: relative for the resistance, else in the channel's unit
    colour : (p,) autoregressive coefficients of the noise, empty for white
    residual : root mean square of the fit's residual (resistance: in log10 ohm), noise included
    misfit : the same on parts of the calibration that the fit was not given; 0 where that was not tried
    residual_colour : (q,) autoregressive coefficients of the residual
    misfit_flat, misfit_steep : of the misfit where the response is flat, and more per variation of it [1], see
        `identification.steepness`; 0 where one figure holds everywhere
    misfit_colour : (q,) autoregressive coefficients of the residual over these sizes
    """

    noise: float = 0.0
    colour: tuple[float, ...] = ()
    residual: float = 0.0
    misfit: float = 0.0
    residual_colour: tuple[float, ...] = ()
    misfit_flat: float = 0.0
    misfit_steep: float = 0.0
    misfit_colour: tuple[float, ...] = ()


def _scalar_parameters() -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"model.{name}", 0.0 if low <= 0.0 else 1.0, unit, text, low, high)
        for name, (unit, text, low, high) in SCALARS.items()
    )


def _sensor_parameters() -> tuple[Parameter, ...]:
    found = []
    for channel in CHANNELS:
        unit = "1" if channel == RESISTANCE else "channel unit"
        spread = "log10 ohm" if channel == RESISTANCE else "channel unit"
        head = f"model.sensors.{channel}"
        found += [
            Parameter(f"{head}.noise", 0.0, unit, f"standard deviation of the noise of {channel}", 0.0),
            Parameter(
                f"{head}.colour", [], "1", f"autoregressive noise coefficients of {channel}", kind="float_array"
            ),
            Parameter(f"{head}.misfit", 0.0, spread, f"residual in {channel} where the fit was not given it, r.m.s.", 0.0),
            Parameter(f"{head}.residual", 0.0, spread, f"residual of the fit in {channel}, root mean square", 0.0),
            Parameter(
                f"{head}.residual_colour", [], "1", f"autoregressive coefficients of the residual of {channel}",
                kind="float_array",
            ),
            Parameter(f"{head}.misfit_flat", 0.0, spread, f"misfit in {channel} where it is flat; 0 for as elsewhere", 0.0),
            Parameter(f"{head}.misfit_steep", 0.0, "1", f"more of it per variation of {channel}", 0.0),
            Parameter(
                f"{head}.misfit_colour", [], "1", f"autoregressive coefficients of the residual of {channel} over these sizes",
                kind="float_array",
            ),
        ]  # fmt: skip
    return tuple(found)


def _effect_parameters() -> tuple[Parameter, ...]:
    found = []
    for record in catalogue().values():
        for head in (
            [f"{record.id}.{channel}" for channel in record.channels] if record.signal else [record.id]
        ):
            found += [replace(p, name=f"model.effects.{head}.{p.name}") for p in record.parameters]
    return tuple(found)


def fitted_names() -> tuple[str, ...]:
    """Return the names (without `model.`) that can have an uncertainty: scalars and the arrays of both banks."""
    banks = [
        p.name.removeprefix("model.")
        for section in _BANKS
        for p in bank_parameters(f"model.{section}", "", "")
    ]
    return (*SCALARS, *banks)


_DELAY = Parameter(
    "model.recording.command_delay",
    0.0,
    "s",
    "time from where a command stands in a recording to where it acts; 0 for this graph",
    -1e6,
    1e6,
)
PARAMETERS: tuple[Parameter, ...] = (
    DeviceParameter(
        "model.device", "", "", "id of a shipped device, or the whole description of another one; empty without model"
    ),
    *_scalar_parameters(),
    _DELAY,
    *law_parameters("model.resistance", "-log10 of the film resistance", "log10 ohm"),
    *law_parameters("model.deflection", "the tip deflection", "m"),
    *_sensor_parameters(),
    *_effect_parameters(),
    *(
        Parameter(
            f"model.uncertainty.{name}", [], "as the parameter", f"standard deviations of {name}", 0.0, kind="float_array"
        )
        for name in fitted_names()
    ),
)  # fmt: skip
"""Every parameter of a model file that this section owns, for nodes to declare."""


@dataclass(frozen=True)
class DeviceModel:
    """Complete fitted simulation of one device.

    Attributes
    ----------
    device : id of a shipped device; the path of a device file, of which the model keeps the whole description
    scalars : values of `SCALARS`, in their units; absent ones are the preset's
    resistance : any law of `hysteresis.laws`, of -log10(R / ohm) over the film temperature
    deflection : the same of the tip deflection [m]; an empty bank of plays where the recording had none
    sensors : channel -> `SensorModel`
    effects : `{id: {parameter: value}}`, for a signal effect `{"id:channel": {..., "signal": channel}}`
    uncertainty : name (without `model.`) -> standard deviations
    command_delay : time from where a command stands in a recording to where it acts [s], see `recording.aligned`

    Raises
    ------
    ValueError : unknown device, parameter, channel or effect, or a value out of range.
    """

    device: str
    scalars: Mapping[str, float] = field(default_factory=dict)
    resistance: Law = field(default_factory=PlayBank)
    deflection: Law = field(default_factory=PlayBank)
    sensors: Mapping[str, SensorModel] = field(default_factory=dict)
    effects: Mapping[str, Mapping[str, float | str]] = field(default_factory=dict)
    uncertainty: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    command_delay: float = 0.0

    def __post_init__(self) -> None:
        description = preset(self.device)
        object.__setattr__(self, "device", description.key)
        nominal = nominal_coefficients(description)
        complete = {}
        known = {p.name.removeprefix("model."): p for p in _scalar_parameters()}
        for name in self.scalars:
            if name not in known:
                raise ValueError(f"model.{name}: is no parameter; need one of {', '.join(known)}")
        for name, parameter in known.items():
            value = float(self.scalars.get(name, nominal[_COEFFICIENT[name]]))
            complete[name] = float(parameter.check(value))  # type: ignore[arg-type]
        object.__setattr__(self, "scalars", complete)
        for channel in self.sensors:
            sensor_index(channel, Sensor.NOISE)
        self.simulation  # noqa: B018  (checks the effects)

    @property
    def description(self) -> DeviceDescription:
        """What the device is."""
        return preset(self.device)

    @property
    def heats(self) -> bool:
        """Whether the drive heats a body that rests cold without it: told by the device's file, or found by a fit."""
        heat = ("thermal.square_gain", "thermal.power_gain")
        return self.description.has_body or any(self.scalars[name] > 0.0 for name in heat)

    @cached_property
    def simulation(self) -> Simulation:
        """The compiled chain of this model."""
        c = nominal_coefficients(preset(self.device))
        for name, value in self.scalars.items():
            c[_COEFFICIENT[name]] = value
        c[Coefficient.PLAY_LOW_R], c[Coefficient.PLAY_HIGH_R] = self._phase_span(self.resistance)
        c[Coefficient.PLAY_LOW_D], c[Coefficient.PLAY_HIGH_D] = self._phase_span(self.deflection)
        for channel, sensor in self.sensors.items():
            kind = Sensor.NOISE_RELATIVE if channel == RESISTANCE else Sensor.NOISE
            c[sensor_index(channel, kind)] = sensor.noise
            c[sensor_index(channel, Sensor.COLOUR)] = sensor.colour[0] if sensor.colour else 0.0
        laws = (self.resistance, self.deflection)
        plays = all(isinstance(law, PlayBank) for law in laws)
        packed_r, packed_d = (law.packed if plays else pack_law(law) for law in laws)
        poly_r, poly_d = (np.asarray(getattr(law, "polynomial", ()), dtype=np.float64) for law in laws)
        return Simulation(
            device=self.device,
            kind=PLAYS,
            coefficients=c,
            packed_r=packed_r,
            packed_d=packed_d,
            poly_r=poly_r,
            poly_d=poly_d,
        ).with_effects(self.effects)

    def _phase_span(self, law: Law) -> tuple[float, float]:
        """What a law's hysteretic output spans while the phase changes; of an absent one so that it divides by one."""
        low, high = law.span
        if isinstance(law, PlayBank) and self.description.has_body:
            reach = 1.0 - np.asarray(law.radii)
            beside = float(np.dot(np.asarray(law.weights)[law.reversible], reach[law.reversible]))
            low, high = low + beside, high - beside
        return (low, high) if high > low else (0.0, 1.0)

    def simulate(
        self,
        current: ArrayLike,
        *,
        dt: float | None = None,
        seed: int = 0,
        noise: bool = True,
        settled: bool = False,
    ) -> Recording:
        """Run the model on a commanded current (n,) [A]; as `Simulation.simulate`."""
        return self.simulation.simulate(current, dt=dt, seed=seed, noise=noise, settled=settled)

    def stepper(self, *, dt: float | None = None, seed: int = 0, noise: bool = True) -> Stepper:
        """Return the model as a stream, bit-identical to `simulate` with the same arguments."""
        return Stepper(self.simulation, dt=dt, seed=seed, noise=noise)

    def to_parameters(self) -> dict[str, Value]:
        """Return the flat `model.*` parameters; the ones that are neutral or empty are left out."""
        flat: dict[str, Value] = {"model.device": self.device}
        left_out = {n for name, names in _NEUTRAL_LEFT_OUT.items() if not self.scalars[name] for n in names}
        flat |= {f"model.{name}": value for name, value in self.scalars.items() if name not in left_out}
        flat[_DELAY.name] = self.command_delay
        for section in _BANKS:
            flat |= getattr(self, section).to_parameters(f"model.{section}")
        for channel, sensor in self.sensors.items():
            head = f"model.sensors.{channel}"
            flat |= {f"{head}.noise": sensor.noise, f"{head}.residual": sensor.residual}
            flat |= {f"{head}.misfit": sensor.misfit} if sensor.misfit else {}
            if sensor.misfit_flat:
                flat |= {
                    f"{head}.misfit_flat": sensor.misfit_flat,
                    f"{head}.misfit_steep": sensor.misfit_steep,
                    f"{head}.misfit_colour": list(sensor.misfit_colour),
                }
            flat |= {
                f"{head}.colour": list(sensor.colour),
                f"{head}.residual_colour": list(sensor.residual_colour),
            }
        for key, values in self.effects.items():
            record = catalogue()[key.split(":")[0]]
            complete, signal = record.complete(values)
            head = f"model.effects.{record.id}.{signal}" if signal else f"model.effects.{record.id}"
            flat |= {f"{head}.{name}": value for name, value in complete.items()}
        flat |= {f"model.uncertainty.{name}": list(std) for name, std in self.uncertainty.items()}
        return {
            name: _plain(value) for name, value in flat.items() if not (isinstance(value, list) and not value)
        }

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> DeviceModel:
        """Return the model of flat `model.*` parameters; names of other sections are ignored.

        Raises
        ------
        ValueError : no device named, a name in a section of the model that is none of it, or a value that is not allowed.
        """
        known = {p.name for p in PARAMETERS}
        for name in sorted(set(parameters) - known):
            if name.startswith(EFFECTS):
                raise ValueError(
                    f"{name}: is no parameter of an effect that is known here; correct it, or give the folder of the effect's "
                    f"file (--effects DIR, or the variable {VARIABLE})"
                )
            if name.startswith(_OWN):
                raise ValueError(f"{name}: is no parameter of a model; correct it or take it out")
        given = {p.name: p.check(parameters[p.name]) for p in PARAMETERS if p.name in parameters}
        device = given.get("model.device", "")
        if not device:
            raise ValueError("model.device: found none, need a model; run `fit` or load its file")
        sensors = {}
        for channel in CHANNELS:
            values = {
                name: given.get(f"model.sensors.{channel}.{name}") for name in SensorModel.__annotations__
            }
            present = {name: _tuple(value) for name, value in values.items() if value not in (None, [])}
            if present:
                sensors[channel] = SensorModel(**present)  # type: ignore[arg-type]
        return cls(
            device=str(device),
            scalars={name: float(given[f"model.{name}"]) for name in SCALARS if f"model.{name}" in given},  # type: ignore[arg-type]
            resistance=law_from_parameters("model.resistance", given),
            deflection=law_from_parameters("model.deflection", given),
            sensors=sensors,
            effects=_effects_of(given),
            command_delay=float(given.get(_DELAY.name, 0.0)),  # type: ignore[arg-type]
            uncertainty={
                name: tuple(given[f"model.uncertainty.{name}"])  # type: ignore[arg-type]
                for name in fitted_names()
                if given.get(f"model.uncertainty.{name}")
            },
        )

    def save(self, path: str | Path, *, comment: str = "") -> None:
        """Write the model file."""
        save_model_parameters(path, self.to_parameters(), comment=comment)

    @classmethod
    def load(cls, path: str | Path) -> DeviceModel:
        """Read a model file; raise a `ValueError` that names the file or the parameter."""
        return cls.from_parameters(load_model_parameters(path))


def _tuple(value: Value | None) -> float | tuple[float, ...]:
    return tuple(value) if isinstance(value, list | tuple) else float(value)  # type: ignore[arg-type]


def _plain(value: Value) -> Value:
    """Turn numpy numbers into plain ones, as a model file holds them."""
    if isinstance(value, list):
        return [float(v) for v in value]
    return value if isinstance(value, str) else float(value)


def _effects_of(given: Mapping[str, Value]) -> dict[str, dict[str, float | str]]:
    """Effects whose parameters are not all neutral."""
    found: dict[str, dict[str, float | str]] = {}
    for record in catalogue().values():
        for signal in record.channels if record.signal else ("",):
            head = f"model.effects.{record.id}.{signal}" if signal else f"model.effects.{record.id}"
            values = {
                p.name: float(given[f"{head}.{p.name}"])  # type: ignore[arg-type]
                for p in record.parameters
                if f"{head}.{p.name}" in given
            }
            neutral = record.neutral()
            if any(value != neutral[name] for name, value in values.items()):
                key = f"{record.id}:{signal}" if signal else record.id
                found[key] = {**values, "signal": signal} if signal else dict(values)
    return found
