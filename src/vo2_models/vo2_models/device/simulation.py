"""One compiled simulation: coefficients and hysteresis of a device, ready to run on any current.

Truth and fitted model both become a `Simulation`; nothing else calls the compiled chain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.device import chain
from vo2_models.device.assembly import FLAGS, plan, state_size
from vo2_models.device.coefficients import (
    CHANNELS,
    HUGE,
    Coefficient,
    Sensor,
    apply_effects,
    blocks,
    first_flag,
    neutral,
    sensor_index,
)
from vo2_models.device.core import ENSEMBLE, PLAYS
from vo2_models.device.description import DeviceDescription, preset
from vo2_models.device.law_step import first_memory, has_law, has_reversible
from vo2_models.device.state import CURRENT_LINE, ChainState, Slot
from vo2_models.effects import effects
from vo2_models.effects.record import SAMPLED
from vo2_models.recording import COMMANDED_CURRENT, Recording
from vo2_models.validation import finite_array, positive_number

__all__ = [
    "FILM_TEMPERATURE",
    "FINE",
    "TRUE_DEFLECTION",
    "TRUE_RESISTANCE",
    "Simulation",
    "longest_lag",
    "nominal_coefficients",
    "white_noise",
]

TRUE_DEFLECTION = "true_tip_deflection"
"""Tip deflection before its sensor [m]."""
FILM_TEMPERATURE = "true_temperature"
"""Film temperature [degC]."""
TRUE_RESISTANCE = "true_film_resistance"
"""Resistance of the film itself, before terminals and sensor [ohm]."""

_NO_LEVELS = np.zeros((2, 2, 0))
_NO_DOMAINS = np.zeros((2, 2, 0), dtype=np.int64)
_NO_PLAYS = np.zeros(7)
_NO_COURSE = np.zeros(0)
_NO_POLYNOMIAL = np.zeros(1)
RESTED = 15.0
"""Time constants of the slowest process after which a device is at rest."""

FINE = 4
"""Steps of a sample where it counts what happens in between."""
RINGING = 0.05
"""Cycles per sample from which a mode follows what happens between samples."""
AT_ONCE = 0.01
"""Shortest time constant of what happens between two samples, in sample periods: what is faster is there at once."""
HELD_IN_RINGS = 200
"""Longest delay, lag or window, in sample periods, that is followed in finer steps: the rings of effects hold no more of them."""

Floats = NDArray[np.float64]


def nominal_coefficients(device: DeviceDescription) -> Floats:
    """Return the coefficients of the driver and thermal model of a `device`, with everything else neutral."""
    c = neutral()
    c[Coefficient.RANGE_LOW], c[Coefficient.RANGE_HIGH] = device.current_range
    c[Coefficient.AMBIENT] = device.ambient
    c[Coefficient.LINEAR_GAIN] = device.linear_gain
    c[Coefficient.SQUARE_GAIN] = 0.0 if device.power_gain else device.square_gain
    c[Coefficient.POWER_GAIN] = device.power_gain
    c[Coefficient.TIME_CONSTANT] = device.time_constant
    c[Coefficient.DEAD_TIME] = device.dead_time
    c[Coefficient.VOLTAGE] = float(device.drive_unit == "V")
    c[Coefficient.ON_STAGE] = float(device.measures_temperature)
    return c


def longest_lag(c: Floats) -> float:
    """Return the longer of the body's time constants [s].

    Parameters
    ----------
    c : (n,) coefficients
    """
    slow = c[Coefficient.SLOW_TIME] if c[Coefficient.SLOW_SHARE] else 0.0
    return float(max(c[Coefficient.TIME_CONSTANT], slow))


def white_noise(seed: int, count: int) -> Floats:
    """Return (count, 4) standard normal numbers, one independent stream per sensor, by the seed."""
    return np.column_stack([generator.standard_normal(count) for generator in noise_generators(seed)])


def noise_generators(seed: int) -> list[np.random.Generator]:
    """Return one generator per sensor channel, by the seed; drawing in pieces gives the numbers of drawing at once."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(len(CHANNELS))]


@dataclass(frozen=True)
class Simulation:
    """Coefficients and hysteresis of one device.

    Attributes
    ----------
    device : preset id
    kind : member of the hysteresis interface, PLAYS or ENSEMBLE of `device.core`
    coefficients : vector as in `device.coefficients`
    packed_r, packed_d : both play banks as `hysteresis.kernels` packs them, or both as `law_step.pack_law` does (PLAYS)
    poly_r, poly_d : polynomial coefficients in degC, lowest first (PLAYS)
    levels, domains : sorted populations, metallic and structural (ENSEMBLE)
    steps_per_constant : thermal steps per time constant where feedback needs them
    force_feedback : take these steps although no effect needs them, so that a fit sees a smooth function
    course : (m,) over a whole run, what is added to the amplitude of an effect that may have any course in time; (0,) for none
    """

    device: str
    kind: int
    coefficients: Floats
    packed_r: Floats = field(default_factory=_NO_PLAYS.copy)
    packed_d: Floats = field(default_factory=_NO_PLAYS.copy)
    poly_r: Floats = field(default_factory=_NO_POLYNOMIAL.copy)
    poly_d: Floats = field(default_factory=_NO_POLYNOMIAL.copy)
    levels: Floats = field(default_factory=_NO_LEVELS.copy)
    domains: NDArray[np.int64] = field(default_factory=_NO_DOMAINS.copy)
    steps_per_constant: float = 4.0
    force_feedback: bool = False
    course: Floats = field(default_factory=_NO_COURSE.copy)

    def with_effects(self, effects: Mapping[str, Mapping[str, float | str]]) -> Simulation:
        """Return the same device with effects `{id: {parameter: value}}`; a signal effect also takes "signal"."""
        c = self.coefficients.copy()
        apply_effects(c, effects, device=self.device)
        return Simulation(**{**self.__dict__, "coefficients": c})

    def with_course(self, key: str, course: Floats) -> Simulation:
        """Return the same device on a run over which (m,) values are added to the amplitude of the effect `key`, evenly in time.

        Parameters
        ----------
        key : of an effect whose record has a `course`; it need not be on
        course : (m,), in the unit of the amplitude

        Raises
        ------
        ValueError : no such effect, or one whose hooks take no course.
        """
        block = blocks().get(key)
        if block is None or not effects()[block.effect].takes_course:
            raise ValueError(f"{key}: need an effect with a hook that takes `course`")
        c = self.coefficients.copy()
        c[block.active] = 1.0
        return Simulation(**{**self.__dict__, "coefficients": c, "course": course})

    @property
    def has_resistance(self) -> bool:
        """Whether there is a law of the metallic transition."""
        return self.kind == ENSEMBLE or has_law(self.packed_r)

    @property
    def has_deflection(self) -> bool:
        """Whether there is a law of the structural transition."""
        return self.kind == ENSEMBLE or has_law(self.packed_d)

    def active(self) -> list[str]:
        """Return the keys, `id` or `id:channel`, of the effects that are on."""
        all_of_them = plan()
        return [all_of_them.keys[k] for k in np.flatnonzero(self.coefficients[all_of_them.active] != 0.0)]

    def prepared(self, dt: float, *, straight: bool = False) -> Floats:
        """Return the coefficients for the sample period `dt` [s], with all that follows from them.

        Parameters
        ----------
        dt : [s]
        straight : what a structure is given goes straight from sample to sample, and not the way of heat

        Raises
        ------
        ValueError : a delay does not fit its line at this sample period.
        """
        c = self.coefficients.copy()
        period = positive_number(dt, "dt")
        c[Coefficient.SAMPLE_PERIOD] = period
        of = plan()
        on = c[of.active] != 0.0
        own_heat, slow = (c[k] != 0.0 for k in (Coefficient.POWER_GAIN, Coefficient.SLOW_SHARE))
        feedback = bool(self.force_feedback or own_heat or slow or np.any(on & of.feedback))
        c[Coefficient.FEEDBACK] = float(feedback)
        plays = (
            self.kind == PLAYS and self.packed_r.ndim == 1
        )  # which tell the input that they were last given
        c[Coefficient.FOLLOWS] = float(plays and not own_heat and not np.any(on & of.every_step))
        c[first_flag() : first_flag() + of.flags.shape[0]] = of.flags @ on
        for name, raised in (("resistance", own_heat), ("any:heat", own_heat or slow), ("any:film", slow)):
            c[first_flag() + FLAGS.index(name)] += float(raised)
        # without a body the input of a law is the drive itself, and its loops may be as thin as one likes
        banks = (self.packed_r, self.packed_d)
        if not (preset(self.device).has_body and any(has_reversible(packed) for packed in banks)):
            c[first_flag() + FLAGS.index("any:phase")] = 0.0
        between = HUGE
        if self.heated or c[Coefficient.HELD]:
            between = max(c[Coefficient.TIME_CONSTANT], AT_ONCE * period)
        c[Coefficient.BETWEEN] = between
        sensed = set()
        for k in np.flatnonzero(on):
            block = blocks()[of.keys[k]]
            record = effects()[block.effect]
            sensed.add(block.signal)
            values = {p.name: float(c[block.places[p.name]]) for p in record.parameters}
            if record.derived:
                numbers = record.hooks["prepare"](
                    values, period, math.inf if straight and self.heated else between
                )
                for name, number in zip(record.derived, numbers, strict=True):
                    c[block.places[name]] = number
            if "delay" in record.hooks:
                c[Coefficient.DEAD_TIME] += record.hooks["delay"](**values)
        steps = math.ceil(self.steps_per_constant * period / c[Coefficient.TIME_CONSTANT]) if feedback else 1
        # the power in a film follows its resistance by a step: of a body's sample no more than a part
        c[Coefficient.SUBSTEPS] = float(max(steps, FINE if own_heat and preset(self.device).has_body else 1))
        if c[Coefficient.DEAD_TIME] > (CURRENT_LINE - 2) * period:
            raise ValueError(
                f"dead time: found {c[Coefficient.DEAD_TIME]:g} s, need at most {CURRENT_LINE - 2} sample periods"
            )
        for channel in CHANNELS:
            noisy = any(c[sensor_index(channel, kind)] for kind in (Sensor.NOISE, Sensor.NOISE_RELATIVE))
            c[sensor_index(channel, Sensor.IDEAL)] = float(not noisy and channel not in sensed)
        return c

    @property
    def heated(self) -> bool:
        """Whether the drive, which is held over a sample, heats a body."""
        gains = self.coefficients[[Coefficient.SQUARE_GAIN, Coefficient.POWER_GAIN]]
        return preset(self.device).has_body or bool(np.any(gains))

    def steps_per_sample(self, dt: float) -> int:
        """Return the steps that a sample takes: `FINE` where it counts what happens between samples, else 1.

        A late or slow sensor and a fast mode feel it, a slow driver makes it; what works on the samples itself does not. On a
        device that no held drive heats, a response goes straight from sample to sample.

        Parameters
        ----------
        dt : sample period [s]
        """
        if not self.heated:
            return 1
        steps, late = 1, float(self.coefficients[Coefficient.DEAD_TIME])
        for key in self.active():
            block = blocks()[key]
            record = effects()[block.effect]
            values = {p.name: float(self.coefficients[block.places[p.name]]) for p in record.parameters}
            late += record.hooks["delay"](**values) if "delay" in record.hooks else 0.0
            if values.get(SAMPLED.name, 0.0) > 0.5:
                continue
            lasts = max((values[p.name] / dt for p in record.parameters if p.unit == "s"), default=0.0)
            tone = max((values[p.name] * dt for p in record.parameters if p.unit == "Hz"), default=0.0)
            if (record.between_samples and lasts <= HELD_IN_RINGS) or tone > RINGING:
                steps = FINE
        # the line of currents holds no longer delay in finer steps
        return steps if late <= (CURRENT_LINE - 2) * dt / FINE else 1

    def initial_state(self) -> ChainState:
        """Return the memory of a device that has rested without current, insulating, for long."""
        banks = [first_memory(packed) for packed in (self.packed_r, self.packed_d)]
        return ChainState(
            scalars=np.zeros(state_size()),
            play_r=banks[0],
            play_d=banks[1],
            metallic=np.zeros((2, self.levels.shape[2]), dtype=np.uint8),
            line=np.zeros(CURRENT_LINE),
        )

    def slowest_time(self) -> float:
        """Return the longest time constant of the body and of the effects that are on [s]."""
        found = [longest_lag(self.coefficients)]
        for key in self.active():
            block = blocks()[key]
            name = effects()[block.effect].slowest_time
            found += [float(self.coefficients[block.places[name]])] if name else []
        return max(found)

    def settled_state(self, current: float, dt: float) -> ChainState:
        """Return the memory of a device that was brought up from its cold rest and then held at a current [A] for long.

        The way there is simulated, for 15 time constants of the body and of the slowest process that has no settled
        value of its own; what has one takes it: slow bodies, what creeps, sensors. The effects' own time stands still.
        """
        state = self.initial_state()
        x = state.scalars
        still = Simulation(
            **{**self.__dict__, "coefficients": self.coefficients.copy(), "course": _NO_COURSE}
        )
        still.coefficients[Coefficient.CLOCK] = 0.0
        for name in (Sensor.NOISE, Sensor.NOISE_RELATIVE):
            still.coefficients[[sensor_index(channel, name) for channel in CHANNELS]] = 0.0
        c = still.prepared(dt)
        held = np.full(self._samples_to_rest(dt, c), float(current))
        law = (self.kind, c, x, self.poly_r, self.poly_d)
        still.run(held, dt=dt, state=state)
        if any(
            effects()[key].stage == "thermal" and effects()[key].states
            for key in self.active()
            if ":" not in key
        ):
            for _ in range(3):  # where the film's resistance heats, the drive itself still moves
                chain.bring_to_rest(*law, x[Slot.CURRENT], True)
                still.run(held, dt=dt, state=state)
            chain.bring_to_rest(*law, x[Slot.CURRENT], True)
        chain.bring_to_rest(*law, x[Slot.CURRENT], False)
        x[Slot.SAMPLE] = 0.0
        state.line[:] = x[Slot.CURRENT]
        return state

    def _samples_to_rest(self, dt: float, c: Floats) -> int:
        """Number of samples that the way to rest takes; 50 000 at the most."""
        way = max(self.slowest_time() * RESTED, 20.0 * dt)
        return int(min((way + c[Coefficient.DEAD_TIME]) / dt, 50_000))

    def run(
        self,
        current: Floats,
        *,
        dt: float,
        normals: Floats | None = None,
        state: ChainState | None = None,
    ) -> Floats:
        """Run on `current` (n,) [A], a step each; return (n, 9) as `chain.COLUMNS` describes. `state` is updated in place.

        `normals` (n, 4) are standard normal numbers for the noise, NaN where no sensor is read.
        """
        c = self.prepared(dt)
        memory = self.initial_state() if state is None else state
        noise = normals
        if noise is None:
            noise = np.zeros((current.size, len(CHANNELS)))
        out = np.empty((current.size, chain.COLUMNS))
        course = self.course
        if course.size not in (0, current.size):
            evenly = np.linspace(0.0, 1.0, current.size)
            course = np.interp(evenly, np.linspace(0.0, 1.0, course.size), course)
        self.call(c, memory, current, noise, out, course)
        return out

    def call(
        self,
        c: Floats,
        state: ChainState,
        current: Floats,
        normals: Floats,
        out: Floats,
        course: Floats = _NO_COURSE,
    ) -> None:
        """Run the compiled chain on checked arrays; nothing is allocated."""
        chain.run_chain(
            self.kind, c, self.packed_r, self.packed_d, self.poly_r, self.poly_d, self.levels, self.domains,
            state.scalars, state.play_r, state.play_d, state.metallic, state.line, current, normals, course, out,
        )  # fmt: skip

    def simulate(
        self,
        current: ArrayLike,
        *,
        dt: float | None = None,
        seed: int = 0,
        noise: bool = True,
        settled: bool = False,
    ) -> Recording:
        """Run the device on a commanded current, from its long cold rest.

        Parameters
        ----------
        current : (n,) commanded current [A]; element k flows during the interval that ends at sample k
        dt : sample period [s], None for the preset's
        seed : of the measurement noise
        noise : whether the sensors add noise
        settled : start from rest at the first current instead

        Returns
        -------
        Recording of the preset's channels at k * dt, with `commanded_current`, and the inner truth under the names
        `true_tip_deflection`, `true_film_resistance`, `true_temperature`.
        """
        nominal = preset(self.device)
        command = finite_array(current, "current")
        period = nominal.sample_period if dt is None else positive_number(dt, "dt")
        steps = self.steps_per_sample(period)
        normals = None
        if noise:
            normals = np.full((command.size * steps, len(CHANNELS)), np.nan)
            normals[steps - 1 :: steps] = white_noise(seed, command.size)
        state = self.settled_state(command[0], period / steps) if settled and command.size else None
        fine = self.run(np.repeat(command, steps), dt=period / steps, normals=normals, state=state)
        out = fine[steps - 1 :: steps]
        channels = {COMMANDED_CURRENT: command}
        channels |= {name: out[:, k] for k, name in enumerate(CHANNELS) if name in nominal.channels}
        inner = {TRUE_DEFLECTION: out[:, 4], FILM_TEMPERATURE: out[:, 5], TRUE_RESISTANCE: out[:, 6]}
        return Recording(period * np.arange(command.size, dtype=np.float64), channels | inner, self.device)


__all__ += ["ENSEMBLE", "PLAYS", "noise_generators"]
