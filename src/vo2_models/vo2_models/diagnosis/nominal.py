"""The fitted simulation as a diagnosis uses it: judged units, noise of each channel, correction of the loop shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import DeviceModel, preset
from vo2_models.device.coefficients import CHANNELS, Coefficient, Sensor, blocks, sensor_index
from vo2_models.device.simulation import FINE, Simulation, longest_lag
from vo2_models.diagnosis.noise import NoiseModel
from vo2_models.diagnosis.propagate_correction import (
    BEHIND_FILM,
    Film,
    corrected_film,
    film_alone,
    propagate_correction,
)
from vo2_models.effects import effects as records
from vo2_models.identification.digest import CalibrationDigest
from vo2_models.identification.enrichment import Correction, EnrichmentBasis
from vo2_models.identification.grid import held
from vo2_models.model_file import load_model_parameters
from vo2_models.parameters import Value
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

__all__ = [
    "JUDGED_UNIT",
    "Nominal",
    "Response",
    "basis_of",
    "drive_of",
    "judged",
    "rounded_with_noise",
    "span_of",
    "transition_of",
]

Floats = NDArray[np.float64]
JUDGED_UNIT = {HEATER_CURRENT: "A", RESISTANCE: "log10 ohm", TIP_DEFLECTION: "m", STAGE_TEMPERATURE: "degC"}
"""Unit in which a channel is compared: resistance in decades, the others as they are."""
TONES = 40
"""Tones of a staircase that are kept."""
FILMS = 8
"""Simulations of the film that are kept: hypotheses about what is behind it ask for the same ones again."""
MESH = 400
"""Temperatures along a branch of the fitted major loop."""
SCATTER = 0.28
"""Standard deviation of the loop's width over the material, as a share of it: that of the shipped devices."""
NEAR, WIDEST = 2.5, 2.0
"""Standard deviations of centre and half width that lie within a basis that is placed as for the shipped devices."""
REACH = 4.0
"""Standard deviations of the centre on both sides that another basis reaches over."""
FAR = 1e15
"""Value at which a simulation that runs away is held: beyond those of any instrument, also in pascals or counts."""
REPEATS = 1e-6
"""Share of its range up to which a logged current only repeats the command."""
_LEAST = 1e-30
"""Value below which no logarithm is taken: below those of any response, also of a capacitance in farad."""
THERMAL = {
    "driver.dead_time": Coefficient.DEAD_TIME,
    "thermal.ambient": Coefficient.AMBIENT,
    "thermal.linear_gain": Coefficient.LINEAR_GAIN,
    "thermal.square_gain": Coefficient.SQUARE_GAIN,
    "thermal.power_gain": Coefficient.POWER_GAIN,
    "thermal.time_constant": Coefficient.TIME_CONSTANT,
}


def judged(channel: str, values: Floats) -> Floats:
    """Return values in the unit in which they are compared: log10 of a resistance in ohm, NaN where it is not positive.

    Parameters
    ----------
    channel : as in a recording
    values : (n,) in the channel's SI unit
    """
    if channel != RESISTANCE:
        return np.asarray(values, dtype=np.float64)
    out = np.full(values.shape, np.nan)
    positive = np.isfinite(values) & (values > 0)
    out[positive] = np.log10(values[positive])
    return out


def drive_of(recording: Recording) -> tuple[Floats, bool]:
    """Return what the simulation is driven with [A], and whether the logged current is a reading of its own.

    Driver effects act between the command and the current. Where the bag has commands these drive the
    simulation, and a logged current that differs from them is one more channel; a logged current that only
    repeats the command says nothing.

    Parameters
    ----------
    recording : with `heater_current` [A] and, where the bag has commands, `commanded_current` [A], (n,) each
    """
    logged = recording[HEATER_CURRENT]
    if COMMANDED_CURRENT not in recording:
        return held(logged), False
    command = recording[COMMANDED_CURRENT]
    command = np.where(np.isfinite(command), command, logged)
    both = np.isfinite(logged)
    scale = max(float(np.ptp(command[both])), 1e-12) if np.any(both) else 1.0
    own = bool(np.any(np.abs(logged[both] - command[both]) > REPEATS * scale))
    return held(command), own


@dataclass(frozen=True)
class Response:
    """What the simulation says about one recording.

    Attributes
    ----------
    channels : channel -> (n,) in judged units
    temperature : (n,) of the film [degC]
    """

    channels: Mapping[str, Floats]
    temperature: Floats


@dataclass(frozen=True)
class Nominal:
    """A fitted simulation with everything a diagnosis needs to know about it.

    Attributes
    ----------
    model : as fitted, with the effects that the fit found
    parameters : the whole model file, for the corrected one
    digest : the calibration in short, None for a model file without it
    noise : channel -> noise in judged units; on a device without body level and colour of what its fit left of the
        calibration
    corrections : channel -> correction of the loop shape, from the digest (resistance and deflection)
    uneven : whether a law's misfit is larger where the response is steep, see `with_uneven_noise`
    """

    model: DeviceModel
    parameters: Mapping[str, Value]
    digest: CalibrationDigest | None
    noise: Mapping[str, NoiseModel]
    corrections: Mapping[str, Correction] = field(default_factory=dict)
    uneven: bool = False

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> Nominal:
        """Read a model file's parameters.

        Raises
        ------
        ValueError : no resistance law in it, or whatever `DeviceModel` refuses.
        """
        model = DeviceModel.from_parameters(parameters)
        if not model.resistance.present and not model.deflection.present:
            raise ValueError("model: found no resistance and no deflection law, need a file that `fit` wrote")
        digest = CalibrationDigest.from_parameters(parameters)
        stored = {
            RESISTANCE: digest.noise_log_resistance if digest else (),
            TIP_DEFLECTION: digest.noise_deflection if digest else (),
            STAGE_TEMPERATURE: digest.noise_stage if digest else (),
            HEATER_CURRENT: digest.noise_current if digest else (),
        }
        noise = {}
        has_body = preset(model.device).has_body
        for channel in CHANNELS:
            if stored.get(channel):
                noise[channel] = NoiseModel(stored[channel][0], tuple(stored[channel][1:]))
                continue
            sensor = model.sensors.get(channel)
            if sensor and sensor.residual > 0.0 and not has_body:
                # the law of such a device misses it by far more than its sensor's noise: that is what it is judged by
                shape = NoiseModel(1.0, sensor.residual_colour)
                noise[channel] = shape.scaled(sensor.residual / shape.level)
                continue
            level = model.sensors[channel].noise if channel in model.sensors else 0.0
            level = level or preset(model.device).noise.get(channel, 0.0)
            if level > 0:
                noise[channel] = NoiseModel(level / np.log(10) if channel == RESISTANCE else level)
        return cls(model, dict(parameters), digest, noise)

    @classmethod
    def load(cls, path: str | Path) -> Nominal:
        """Read a model file; raise a `ValueError` that names the file or the parameter."""
        return cls.from_parameters(load_model_parameters(path))

    def with_uneven_noise(self) -> Nominal:
        """The same with noise as the fit missed parts of the calibration that it was not given: more where they are steep."""
        two = {
            c: sensor for c, sensor in self.model.sensors.items() if sensor.misfit_flat and c in self.noise
        }
        shapes = {c: NoiseModel(1.0, sensor.misfit_colour) for c, sensor in two.items()}
        noise = {c: shape.scaled(two[c].misfit / shape.level) for c, shape in shapes.items()}
        return replace(self, noise={**self.noise, **noise}, uneven=True)

    def with_slow_misfit_told(self, most: float) -> Nominal:
        """The same with white noise of the size of its innovations where its level is more than `most` times theirs.

        What is as slow as that is no sensor's noise: it is what the fit missed of the calibration. Nothing is fitted to the
        reading of a current, which may be late behind its command.
        """
        noise = {
            c: NoiseModel(one.innovation)
            if one.level > most * one.innovation and c != HEATER_CURRENT
            else one
            for c, one in self.noise.items()
        }
        return self if noise == dict(self.noise) else replace(self, noise=noise)

    @property
    def device(self) -> str:
        """Preset id."""
        return self.model.device

    @property
    def span(self) -> dict[str, float]:
        """Range of each channel in judged units."""
        return span_of(self.device)

    def _noise_of(self, channel: str, values: Floats) -> Floats:
        """Noise of a channel (n,) in its own unit."""
        level = self.noise[channel].level if channel in self.noise else 0.0
        return (
            np.abs(values) * level * np.log(10.0) if channel == RESISTANCE else np.full(values.shape, level)
        )

    @cached_property
    def _films(self) -> Callable[[bytes, bytes, float, bytes], Film]:
        """Corrected film for coefficients, current [A], sample period [s] and course, the last few kept."""
        plain, corrections = self.model.simulation, self.corrections
        from_rest = self.model.description.has_body

        @lru_cache(maxsize=FILMS)
        def film(coefficients: bytes, current: bytes, dt: float, course: bytes) -> Film:
            chain = replace(
                plain,
                coefficients=np.frombuffer(coefficients).copy(),
                course=np.frombuffer(course).copy(),
            )
            out = _bounded(chain.run(np.frombuffer(current).copy(), dt=dt))
            return corrected_film(chain, out, dt, corrections, from_rest=from_rest)

        return film

    def _finer(self, current: Floats, steps: int) -> Floats:
        """A drive (n,) in `steps` steps a sample: a current is held, what drives a device without body moves on in between."""
        if self.model.heats:
            return np.repeat(current, steps)
        ends = np.arange(1, current.size + 1)
        return np.interp(np.arange(1, current.size * steps + 1) / steps, ends, current)

    def respond(
        self,
        current: Floats,
        dt: float,
        *,
        effects: Mapping[str, Mapping[str, float | str]] | None = None,
        constants: Mapping[str, float] | None = None,
        settled: bool = False,
        fine: bool = True,
        course: tuple[str, Floats] | None = None,
    ) -> Response:
        """Simulate without noise.

        A drive that heats nothing and comes late by parts of a sample gives what lies between the responses to one that is late
        by whole samples: as a late clock of a response does, from which it then differs in nothing.

        Parameters
        ----------
        current : (n,) what drives the device [A]
        dt : sample period [s]
        effects : what is added
        constants : values that replace those of the model, by name as in `nuisance.constants_of`; of a gain of the resistance,
            which is judged by its logarithm, 1 + ln gain
        settled : whether the device had come to rest at the first current before, instead of at no current
        fine : take several steps a sample where it counts what happens in between
        course : effect, and (n,) what is added to its amplitude, see `Simulation.with_course`
        """

        def run(given: Mapping[str, Mapping[str, float | str]] | None) -> Response:
            return self._run(current, dt, given, constants, settled, fine, course)

        late = next((key for key in effects or {} if "delay" in records()[key.partition(":")[0]].hooks), None)
        if self.model.heats or effects is None or late is None:
            return run(effects)
        samples = float(effects[late].get("delay", 0.0)) / dt
        whole = int(samples)
        share = samples - whole
        early, later = (run({**effects, late: {**effects[late], "delay": dt * (whole + k)}}) for k in (0, 1))
        channels = {
            channel: (1.0 - share) * values + share * later.channels[channel]
            for channel, values in early.channels.items()
        }
        return Response(channels, (1.0 - share) * early.temperature + share * later.temperature)

    def _run(
        self,
        current: Floats,
        dt: float,
        effects: Mapping[str, Mapping[str, float | str]] | None,
        constants: Mapping[str, float] | None,
        settled: bool,
        fine: bool,
        course: tuple[str, Floats] | None,
    ) -> Response:
        """As `respond`, with any delay as the simulation has it."""
        chain = _noiseless(self.model.simulation)
        c = chain.coefficients.copy()
        given = constants or {}
        for name, place in THERMAL.items():
            c[place] = given.get(name, c[place])
        chain = replace(chain, coefficients=c)
        if effects:
            chain = chain.with_effects(effects)
        chain, grids = _without_rounding(chain)
        lead = 0
        if settled:
            lead = int(np.ceil(10 * (longest_lag(c) + c[Coefficient.DEAD_TIME]) / dt))
            if not self.model.heats:  # no lag of a body that is longer than what effects add
                lead = min(
                    lead
                    + int(np.ceil(10 * _longest_before_film({**self.model.effects, **(effects or {})}) / dt)),
                    current.size,
                )
            current = np.concatenate([np.full(lead, current[0]), current])
        if course is not None:
            chain = chain.with_course(course[0], np.pad(course[1], (lead, 0), mode="edge"))
        steps = _steps_between(chain, dt) if fine else 1
        if steps > 1:
            current, dt = self._finer(current, steps), dt / steps
        # a candidate may drive the simulation out of anything physical: it must only look very wrong
        resting = settled and not self.model.heats
        if self.corrections or resting:
            alone = film_alone(chain.coefficients)
            film = self._films(alone.tobytes(), current.tobytes(), dt, chain.course.tobytes())
            if resting:  # what is behind the film begins at rest with it, a ring too
                film, lead = film.resting_until(lead * steps), 0
            out = _finite(propagate_correction(chain, film, dt, every=steps))
        else:
            out = _bounded(chain.run(current, dt=dt))[steps - 1 :: steps]
        temperature = out[:, 5].clip(-1e4, 1e4)
        found = {}
        for k, channel in enumerate(CHANNELS):
            if channel == STAGE_TEMPERATURE and not preset(self.device).measures_temperature:
                continue
            values = out[:, k]
            if channel in grids:
                values = rounded_with_noise(values, grids[channel], self._noise_of(channel, values))
            if channel == TIP_DEFLECTION:
                values = given.get("deflection.gain", 1.0) * values + given.get("deflection.zero", 0.0)
            if channel == RESISTANCE:
                values = np.log10(np.maximum(values, _LEAST)) + (
                    given.get("resistance.gain", 1.0) - 1.0
                ) / np.log(10)
            found[channel] = values
        return Response({k: v[lead:] for k, v in found.items()}, temperature[lead:])


def rounded_with_noise(values: Floats, step: float, noise: Floats) -> Floats:
    """Return the mean of step round((x + n) / step) over Gaussian noise n: what a coarse converter shows of x on average.

    x + step / pi sum_m (-1)^m / m exp(-2 (pi m s / step)^2) sin(2 pi m x / step), s the noise: the Fourier series of the
    staircase, damped as noise damps each tone. Without noise it is the staircase.

    Parameters
    ----------
    values : (n,) x
    step : distance of neighbouring values
    noise : (n,) standard deviations
    """
    share = np.maximum(noise / step, 0.02)  # below, forty tones would not do
    out = values.copy()
    phase = 2.0 * np.pi * values / step
    for m in range(1, TONES + 1):
        damping = np.exp(-2.0 * (np.pi * m * share) ** 2)
        out += step / np.pi * (-1.0) ** m / m * damping * np.sin(m * phase)
    return out


def _longest_before_film(given: Mapping[str, Mapping[str, float | str]]) -> float:
    """The times of effects in front of the film together [s]: delays, lags, windows."""
    return sum(
        float(values[p.name])
        for key, values in given.items()
        if records()[key.partition(":")[0]].stage not in BEHIND_FILM
        for p in records()[key.partition(":")[0]].parameters
        if p.unit == "s" and p.name in values
    )


def _without_rounding(chain: Simulation) -> tuple[Simulation, dict[str, float]]:
    """The same chain with fine converters, and the steps of the coarse ones."""
    steps = {block.signal: block for block in blocks().values() if block.effect == "adc_quantization"}
    grids = {
        channel: float(chain.coefficients[block.places["step"]])
        for channel, block in steps.items()
        if chain.coefficients[block.active]
    }
    if not grids:
        return chain, {}
    c = chain.coefficients.copy()
    c[[steps[channel].active for channel in grids]] = 0.0
    return replace(chain, coefficients=c), grids


def _steps_between(chain: Simulation, dt: float) -> int:
    """Steps that a sample takes: of a held drive those of the simulation, see `Simulation.steps_per_sample`.

    Where the drive is not held but moves on, any share of a sample makes it late, and a response goes straight from one
    sample to the next: that is all that acts behind the film takes from it. Where the loops relax, they were fitted behind
    a held drive.
    """
    if chain.heated:
        return chain.steps_per_sample(dt)
    acting = [records()[blocks()[key].effect] for key in chain.active()]
    if any("follow" in record.hooks for record in acting):
        return 1
    before = [record for record in acting if record.stage not in BEHIND_FILM]
    return FINE if any(record.between_samples for record in before) else 1


def transition_of(model: DeviceModel) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return mean and standard deviation over the material of the transition on heating [degC, K], and of the loop's width [K].

    A device's file may tell them. Else they are those of the fitted loop: on a major loop, the temperatures at which half
    of it is done, and half of the way from 16 to 84 per cent. Of a model without loops what its file leaves open stands.

    Parameters
    ----------
    model : fitted simulation
    """
    own = model.description
    law = next((law for law in (model.resistance, model.deflection) if law.present), None)
    if law is None or not own.has_body or own.tells("transition"):
        return own.heating, own.width
    cold, hot = sorted(own.steady_temperature(i) for i in own.operating_range)
    way = np.linspace(min(cold, own.ambient), hot, MESH)
    both = np.concatenate([way, way[::-1]])
    output = law.run(both) - law.polynomial_part(both)
    quantiles = []
    for branch in (output[:MESH], output[MESH:][::-1]):
        if branch[-1] == branch[0]:
            return own.heating, own.width
        share = np.maximum.accumulate((branch - branch[0]) / (branch[-1] - branch[0]))
        quantiles.append(np.interp((0.16, 0.5, 0.84), share, way))
    up, down = quantiles
    width = max(float(up[1] - down[1]), way[1] - way[0])
    return (float(up[1]), float(0.5 * (up[2] - up[0]))), (width, SCATTER * width)


def basis_of(model: DeviceModel) -> EnrichmentBasis:
    """Return the basis of the loop-shape correction of a device, placed where its loops are.

    Parameters
    ----------
    model : fitted simulation
    """
    nominal = model.description
    heating, width = transition_of(model)
    cold, hot = sorted(nominal.steady_temperature(i) for i in nominal.operating_range)
    basis = EnrichmentBasis(
        typical_centre=(heating[0] - 0.5 * width[0], heating[1]),
        typical_half_width=(0.5 * width[0], 0.5 * width[1]),
        temperature_degc=(min(cold, nominal.ambient) - 5.0, hot + 10.0),
    )
    if not nominal.has_body:  # loops over a drive may be anywhere in its range
        return replace(basis, temperature_degc=(cold, hot)).over(cold, hot)
    centre, spread = basis.typical_centre
    widest = basis.typical_half_width[0] + WIDEST * basis.typical_half_width[1]
    low, high = basis.centre_degc
    near = low <= centre - NEAR * spread and centre + NEAR * spread <= high and widest <= basis.half_width_k
    if near or nominal.tells("transition"):
        return basis
    reach = max(REACH * spread, 0.5 * (high - low) * widest / basis.half_width_k)
    return basis.over(centre - reach, centre + reach)


def loop_ends(model: DeviceModel) -> tuple[float, float]:
    """Temperatures [degC] below and above which a device of this kind has next to no memory.

    Parameters
    ----------
    model : fitted simulation
    """
    heating, width = transition_of(model)
    spread = 2.5 * heating[1]
    return heating[0] - width[0] - spread, heating[0] + spread


def span_of(device: str) -> dict[str, float]:
    """Return the range of each channel of a device in judged units: what shares of range divide by.

    Parameters
    ----------
    device : preset or path of a device file
    """
    nominal = preset(device)
    low, high = nominal.resistance_range
    currents = nominal.operating_range
    temperatures = [nominal.steady_temperature(i) for i in currents]
    return {
        HEATER_CURRENT: abs(currents[1] - currents[0]),
        RESISTANCE: float(np.log10(high / low)),
        TIP_DEFLECTION: nominal.deflection_range,
        STAGE_TEMPERATURE: abs(temperatures[1] - temperatures[0]),
    }


def _finite(out: Floats) -> Floats:
    if not (
        float(np.min(out, initial=0.0)) > -FAR and float(np.max(out, initial=0.0)) < FAR
    ):  # not a number, too
        out = np.nan_to_num(out, nan=FAR, posinf=FAR, neginf=-FAR).clip(-FAR, FAR)
    return out


def _bounded(out: Floats) -> Floats:
    out = _finite(out)
    np.clip(out[:, 5], -1e3, 1e4, out=out[:, 5])
    return out


def _noiseless(chain: Simulation) -> Simulation:
    """The same chain with quiet sensors."""
    c = chain.coefficients.copy()
    for channel in CHANNELS:
        for coefficient in (Sensor.NOISE, Sensor.NOISE_RELATIVE):
            c[sensor_index(channel, coefficient)] = 0.0
    return replace(chain, coefficients=c)
