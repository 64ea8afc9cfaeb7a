"""What an effect is: a named term with its equation, parameters, states and compiled hooks."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from vo2_models.effects.magnitude import NEEDS, lacks, magnitudes, unit_parts
from vo2_models.parameters import Parameter
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = [
    "ADVANCE",
    "ALL",
    "CHOICE",
    "DEVICE",
    "FILM",
    "HEAT",
    "HOOKS",
    "PHASE",
    "PLAIN",
    "SAMPLED",
    "SENSED",
    "SETTLED",
    "Effect",
    "Hook",
    "Stage",
    "State",
    "constant_of",
]

Stage = Literal["driver", "thermal", "transition", "terminals", "structure", "sensor"]

FILM = (RESISTANCE, TIP_DEFLECTION)
"""What a change of the film's temperature or phase reaches."""
HEAT = (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
"""What a change of the heated body's temperature reaches."""
ALL = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
"""What a change of the current itself reaches."""
SENSED = (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
"""Channels with a sensor of their own."""

_FAMILIES = {"driver": "drive", "thermal": "heat", "terminals": "film"}
"""Stage -> family, where the words differ; a sensor's family has the channel's name behind it."""

DEVICE = ("time_constant_of_body", "time_constant_between", "ambient_of_device", "on_stage")
"""Constants of the device that every hook can take: [s]; [s], that with which a response moves on between two samples, HUGE
where it goes straight; [degC]; 1 where the film sits on a heated stage that has a
temperature of its own, 0 where film and heated body are one."""


@dataclass(frozen=True)
class Hook:
    """One place of the chain where an effect can act.

    Attributes
    ----------
    stage : the stage it belongs to
    takes : quantities of the stage that a hook function can name among its arguments, with their units
    gives : what it returns, with its unit
    substeps : whether the exact one-step solution of the linear thermal model does not suffice with it
    """

    stage: Stage
    takes: Mapping[str, str]
    gives: str
    substeps: bool = False


HOOKS: dict[str, Hook] = {
    "drive": Hook("driver", {"current": "A", "previous": "A", "time": "s", "period": "s"}, "current [A]"),
    "delay": Hook("driver", {}, "seconds added to the dead time"),
    "ambient": Hook("thermal", {"time": "s"}, "kelvins added to the ambient temperature"),
    "heating": Hook(
        "thermal",
        {"current": "A", "joule": "K", "resistance": "ohm", "time": "s"},
        "kelvins added to the temperature rise that the drive holds at rest",
    ),
    "pumping": Hook(
        "thermal",
        {"current": "A", "joule": "K"},
        "part of the temperature rise added to the drive [1]",
        substeps=True,
    ),
    "conductance": Hook(
        "thermal", {"fraction": "1"}, "relative change of the thermal conductance [1]", substeps=True
    ),
    "loss": Hook(
        "thermal",
        {"rise": "K"},
        "relative additional loss [1], and the derivative of rise times loss [1]",
        substeps=True,
    ),
    "lag": Hook("thermal", {"surplus": "K"}, "factor of the body's time constant [1]"),
    "latent": Hook("thermal", {}, "kelvins that the whole transition takes up", substeps=True),
    "body": Hook(
        "thermal",
        {},
        "change of the body's temperature per kelvin of rise [1], and kelvins added to it",
        substeps=True,
    ),
    "film": Hook("thermal", {"resistance": "ohm", "time": "s"}, "kelvins of the film above its body"),
    "shift": Hook("transition", {"film": "degC"}, "kelvins added to what both transitions see"),
    "structural_shift": Hook(
        "transition", {"film": "degC"}, "kelvins added to what the structural transition sees"
    ),
    "feedback": Hook(
        "transition",
        {"share": "1"},
        "kelvins added to what a transition sees, from its own switched share",
        substeps=True,
    ),
    "follow": Hook(
        "transition",
        {"equilibrium": "output", "before": "output", "output": "output", "h": "s"},
        "output after a step of h at whose begin the equilibrium was `before` and the output `output`",
        substeps=True,
    ),
    "beside": Hook(
        "transition",
        {"half_way": "1", "film": "degC", "middle": "1"},
        "fraction added to the switched one; half_way = 4 s (1 - s); middle: anhysteretic fraction minus s",
        substeps=True,
    ),
    "terminals": Hook(
        "terminals",
        {"value": "ohm", "current": "A", "time": "s", "film": "degC"},
        "resistance at the terminals [ohm]",
    ),
    "bending": Hook("structure", {"film": "degC", "fraction": "1"}, "metres added to the film's deflection"),
    "structure": Hook("structure", {"deflection": "m", "period": "s"}, "deflection [m]"),
    "sensor": Hook(
        "sensor",
        {"value": "unit", "time": "s", "period": "s", "sample": "1", "current": "A"},
        "value before the sensor's noise, in the channel's unit",
    ),
    "converter": Hook(
        "sensor", {"value": "unit", "time": "s"}, "value behind the noise, in the channel's unit"
    ),
}
"""Every hook by name. A hook is a function of that name in the effect's file; what it needs it names as arguments:
quantities of its stage, own parameters, own states, numbers of `prepare`, and constants of the device."""

ADVANCE: Mapping[str, Mapping[str, str]] = {
    "driver": {"current": "A", "period": "s"},
    "thermal": {"drive": "K", "rise": "K", "h": "s", "time": "s"},
    "transition": {"film": "degC", "h": "s"},
    "terminals": {"value": "ohm", "current": "A", "period": "s"},
    "structure": {"deflection": "m", "period": "s"},
    "sensor": {"value": "unit", "period": "s", "sample": "1"},
}
"""Stage -> what `advance`, which moves the states on by one step, can take besides parameters and states. It returns the states
of one number, in the order of `Effect.states`; those of several it changes in `memory`."""
PLAIN = ("prepare", "evident", "line")
"""Functions of an effect's file that are not compiled: `prepare`, see `derived`, and of an effect on one signal, that is not
fitted where it is not seen, `evident` or `line`. `evident` takes the values (n,) that were measured, in the channel's unit,
and returns None, or what they show by themselves: the effect's parameters, and (n,) the values that say no more than that the
true ones are beyond them. `line` takes what the simulation leaves of a channel, in its unit, NaN where nothing was measured,
the standard deviation that is usual there and the simulated values, each (n,), and the sample period [s]; it returns None, or
the effect's parameters, among them `frequency` [Hz], and their standard deviations."""
SETTLED: Mapping[str, Mapping[str, str]] = {
    "driver": {"current": "A"},
    "thermal": {"drive": "K"},
    "transition": {"film": "degC"},
    "terminals": {"value": "ohm"},
    "structure": {"deflection": "m"},
    "sensor": {"value": "unit"},
}
"""Stage -> what `settled`, which returns all states after a long rest in the order of `Effect.states`, can take besides
parameters; a state of several numbers may rest at one."""


_CHANNELS = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)


@dataclass(frozen=True)
class State:
    """One memory of an effect.

    Attributes
    ----------
    name : as the hooks take it
    unit : SI unit text
    description : one sentence
    settled : value after a long rest; None where the function `settled` of the file gives all states
    size : how many numbers; a hook takes `memory` and finds the first of several at the place `memory[NAME]`
    """

    name: str
    unit: str
    description: str
    settled: float | None = None
    size: int = 1


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes
    ----------
    id : name in the contract, and of the file
    stage : part of the chain it belongs to
    parameters : name, unit, physical bounds and neutral value (`default`) of each parameter
    channels : channels it can reach; for a signal effect the signals it can sit on, of which it reaches one
    equation : the added term
    excitation : what a recording must contain to show it
    source : where the term comes from
    statement : one paragraph in words
    states : memories of the effect
    slowest_time : parameter that holds the time constant with which the effect comes to rest, where that is not told by
        settled values; empty for none
    signal : whether it sits on one channel, named with "signal"
    needs : what a device must have for it, words of `magnitude.NEEDS`
    typical : shipped device, or "device:signal", -> parameter -> range of clearly visible magnitudes, for demonstrations
    fixed : parameters that an excitation cannot separate from the others; a fit leaves them at their default
    course : parameter whose product with the time is the effect's amplitude, where that may take any slow course in time
        and a straight line is the simplest; empty for none. A hook that takes `course`, in the unit of the amplitude, and adds it
        has its large courses simulated; else they are linear
    same_values : ids of effects that would give its channel the same values and are no candidates there; on a device without
        body, where nothing else tells them apart, the answer holds them too
    linear : whether what a structure or a sensor makes of a sum is the sum of what it makes of the parts
    order : place among the effects of its hook, lowest first; the order of the signal's way through the device
    derived : names of the numbers that `prepare(values, period, time_constant)` returns, for the hooks
    between_samples : whether what happens between two samples counts with it
    hooks, file : filled in by the catalogue: the functions of the effect's file, and its path
    """

    id: str
    stage: Stage
    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    typical: Mapping[str, Mapping[str, tuple[float, float]]] = field(hash=False)
    equation: str
    excitation: str
    source: str
    statement: str
    states: tuple[State, ...] = ()
    slowest_time: str = ""
    signal: bool = False
    needs: tuple[str, ...] = ()
    fixed: tuple[str, ...] = ()
    course: str = ""
    same_values: tuple[str, ...] = ()
    linear: bool = True
    order: int = 50
    derived: tuple[str, ...] = ()
    between_samples: bool = False
    hooks: Mapping[str, Callable[..., Any]] = field(default_factory=dict, hash=False, compare=False)
    file: str = field(default="", compare=False)

    def family(self, signal: str = "") -> str:
        """Return the family of the contract: drive, heat, transition, film, structure, sensor:CHANNEL, clock:CHANNEL."""
        if self.stage == "sensor":
            late = any(p.name == "delay" for p in self.parameters)
            return f"{'clock' if late else 'sensor'}:{signal}"
        return _FAMILIES.get(self.stage, self.stage)

    def neutral(self) -> dict[str, float]:
        """Return the parameter values at which the effect is off."""
        return {parameter.name: float(parameter.default) for parameter in self.parameters}  # type: ignore[arg-type]

    @property
    def takes_course(self) -> bool:
        """Whether a hook takes the course of the amplitude, so that a large one is simulated."""
        return any("course" in inspect.signature(hook).parameters for hook in self.hooks.values())

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

    def occurs_on(self, device: str) -> bool:
        """Return whether a device, by id, path or text, has what the effect needs."""
        from vo2_models.device.description import preset

        return not lacks(self, preset(device))

    def magnitudes(self, device: str, signal: str = "") -> Mapping[str, tuple[float, float]]:
        """Return parameter -> (low, high) of clearly visible magnitudes on a device; see `magnitude.magnitudes`."""
        from vo2_models.device.description import preset

        return magnitudes(self, preset(device), signal)

    def draw(self, device: str, rng: np.random.Generator) -> dict[str, float | str]:
        """Draw a clearly visible instance (values log-uniform over `typical`), with its signal where it has one."""
        signal = str(rng.choice(self.signals(device)))
        values: dict[str, float | str] = {
            name: float(np.exp(rng.uniform(np.log(low), np.log(high))))
            for name, (low, high) in self.magnitudes(device, signal).items()
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

    def check(self) -> None:
        """Raise a `ValueError` that names file, key, what was found and what is needed, where the file is not sound."""
        where = self.file or f"effect {self.id}"
        if self.stage not in get_args(Stage):
            raise ValueError(
                f"{where}: stage: found {self.stage!r}, need one of {', '.join(get_args(Stage))}"
            )
        for p in self.parameters:
            if not p.unit:
                raise ValueError(
                    f"{where}: parameter {p.name}: found no unit, need an SI unit text, 1 for a number"
                )
            try:
                unit_parts(p.unit)
            except ValueError as error:
                raise ValueError(f"{where}: parameter {p.name}: {error}") from error
            if p.lower is None or p.upper is None:
                raise ValueError(
                    f"{where}: parameter {p.name}: found no lower and upper bound, need what is physically possible, in {p.unit}"
                )
            if not p.lower < p.upper:
                raise ValueError(
                    f"{where}: parameter {p.name}: found bounds {p.lower} to {p.upper}, need lower < upper"
                )
            if not p.lower <= float(p.default) <= p.upper:  # type: ignore[arg-type]
                raise ValueError(
                    f"{where}: parameter {p.name}: found the neutral value {p.default}, need one within {p.lower:g} to "
                    f"{p.upper:g}"
                )
        for channel in (self.channels,) if isinstance(self.channels, str) else self.channels:
            if channel not in _CHANNELS or isinstance(self.channels, str):
                raise ValueError(
                    f"{where}: channels: found {channel!r}, need a tuple of some of {', '.join(_CHANNELS)}"
                )
        self._check_typical(where)
        for need in self.needs:
            if need not in NEEDS:
                raise ValueError(f"{where}: needs: found {need!r}, need some of {', '.join(NEEDS)}")
        for name in {"evident", "line"} & set(self.hooks):
            if not self.signal:
                raise ValueError(f"{where}: {name}: found no signal, need an effect that sits on one channel")
        own = {p.name for p in self.parameters}
        for state in self.states:
            if state.size < 1:
                raise ValueError(f"{where}: state {state.name}: found size {state.size}, need 1 or more")
            if state.settled is None and "settled" not in self.hooks:
                raise ValueError(
                    f"{where}: state {state.name}: found no settled value, need a number or a function settled"
                )
        acting = [name for name in self.hooks if name in HOOKS]
        if not acting:
            raise ValueError(f"{where}: found no hook, need a function named one of {', '.join(HOOKS)}")
        if self.states and "advance" not in self.hooks:
            raise ValueError(
                f"{where}: found states but no hook advance, need a function that returns their next values"
            )
        if self.derived and "prepare" not in self.hooks:
            raise ValueError(f"{where}: found derived numbers but no function prepare that returns them")
        if self.slowest_time and self.slowest_time not in own:
            raise ValueError(
                f"{where}: slowest_time: found {self.slowest_time!r}, need a parameter of the effect"
            )
        known = own | {s.name for s in self.states} | set(self.derived) | set(DEVICE)
        known |= {"course"} if self.course else set()
        known |= {"memory"} if any(s.size > 1 for s in self.states) else set()
        for name, function in self.hooks.items():
            if name in PLAIN:
                continue
            by_stage = {"advance": ADVANCE, "settled": SETTLED}.get(name)
            takes = by_stage[self.stage] if by_stage else HOOKS[name].takes
            for argument in inspect.signature(function).parameters:
                if argument not in known and argument not in takes:
                    raise ValueError(
                        f"{where}: hook {name}: found the argument {argument!r}, need some of "
                        f"{', '.join([*takes, *sorted(known)])}"
                    )

    def _check_typical(self, where: str) -> None:
        """Raise where `typical` holds no magnitude that can be drawn, or names what no device or parameter has."""
        from vo2_models.device.description import PRESETS

        place, known = f"{where}: typical", {p.name: p for p in self.parameters}
        if not any(self.typical.values()):
            raise ValueError(
                f"{place}: found no range, need one of a parameter on one of {', '.join(PRESETS)}"
            )
        for key, ranges in self.typical.items():
            device, colon, signal = key.partition(":")
            if device not in PRESETS or (colon and not (self.signal and signal in self.channels)):
                raise ValueError(
                    f"{place}: found {key!r}, need one of {', '.join(PRESETS)}; of an effect on one channel with :CHANNEL"
                )
            if strange := sorted(set(ranges) - set(known)):
                raise ValueError(f"{place}: {key}: found {', '.join(strange)}, need parameters of the effect")
            for name, pair in ranges.items():
                lower, upper = known[name].lower, known[name].upper
                if len(pair) != 2 or not (pair[0] > 0.0 and lower <= pair[0] <= pair[1] <= upper):  # type: ignore[operator]
                    raise ValueError(
                        f"{place}: {key}: {name}: found {pair}, need (low, high) above 0 and within {lower:g} to {upper:g}"
                    )


def constant_of(
    name: str,
    default: float,
    unit: str = "",
    description: str = "",
    lower: float | None = None,
    upper: float | None = None,
) -> Parameter:
    """Return a `Parameter` of an effect; what is left out, `Effect.check` asks for with file and parameter.

    Parameters
    ----------
    name : as the hooks take it
    default : neutral value, at which the effect is off
    unit : SI unit text, 1 for a number
    description : one line
    lower, upper : physical bounds
    """
    low, high = (None if bound is None else float(bound) for bound in (lower, upper))
    return Parameter(name, float(default), unit, description, low, high)


CHOICE = "choice"
"""Unit of a parameter that is one of two alternatives, 0 or 1: tried both ways, never fitted."""
PHASE = constant_of(
    "phase", 0, CHOICE, "transition whose fraction s counts: 0 the structural one, 1 the metallic one", 0, 1
)
"""Parameter of an effect whose hook takes `fraction`, or that has latent heat: which fraction that is."""
SAMPLED = constant_of(
    "sampled",
    0,
    CHOICE,
    "0 for a sensor that acts all the time, 1 for a program that is given the values at the samples",
    0,
    1,
)
"""Parameter of a sensor's effect that is a filter: of a signal that moves between its samples these are not the same."""
