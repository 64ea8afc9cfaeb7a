"""From commanded currents to the channels a rig logs: driver, core, structure, film, sensors, converter.

Effects hook into a `Plan`, stage by stage; a plan without hooks is the plain device. Times inside a run start at 0.
The simulation runs on a grid finer than the samples (`Preset.substeps`): element m of a fine array is the instant
m * step, except driver currents, where element m flows from m * step to (m + 1) * step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

from vo2_studies.challenge.core import Terms, run_core
from vo2_studies.challenge.devices import Device, log_resistance, static_deflection
from vo2_studies.challenge.families.law import widen
from vo2_studies.challenge.noise import ChannelNoise, draw_noise, sample_noise

__all__ = ["Noise", "Plan", "Truth", "channels_of", "draw_rig_noise", "log_channels", "simulate"]

Array = NDArray[np.floating]


@dataclass
class Plan:
    """Hooks of all effects of one case; empty means the plain device.

    Attributes
    ----------
    terms : coefficients of the coupled core, by name of `Terms`
    dead_time : additional delay between current and heat [s]
    driver : (current (m,), step) -> current, on the fine grid [A]
    ambient : time (m,) -> change of the ambient temperature [K]
    heat : (nominal heat input (m,) [K], step) -> change of the ambient temperature [K]
    local : time (m,) -> film and cantilever above the heated body [K]
    shift : (time (m,), current (m,)) -> what the transition sees besides the film's temperature [K]
    widening : structural loop wider than the metallic by this [K]
    phase : (step, film temperature, metal, structure, device) -> metal, structure, on the fine grid
    film : (time, resistance, film temperature, current) -> resistance [ohm], fine grid
    structure : (time, deflection, film temperature, structure fraction, device) -> deflection [m], fine grid
    readout : channel -> (time, step, values) -> values, on the fine grid before sampling
    sampled : channel -> (time, values) -> values at the samples
    converter : channel -> values -> values, after the noise
    """

    terms: dict[str, float] = field(default_factory=dict)
    dead_time: float = 0.0
    driver: list[Callable[[Array, float], Array]] = field(default_factory=list)
    ambient: list[Callable[[Array], Array]] = field(default_factory=list)
    heat: list[Callable[[Array, float], Array]] = field(default_factory=list)
    local: list[Callable[[Array], Array]] = field(default_factory=list)
    shift: list[Callable[[Array, Array], Array]] = field(default_factory=list)
    widening: float = 0.0
    phase: list[Callable[[float, Array, Array, Array, Device], tuple[Array, Array]]] = field(
        default_factory=list
    )
    film: list[Callable[[Array, Array, Array, Array], Array]] = field(default_factory=list)
    structure: list[Callable[[Array, Array, Array, Array, Device], Array]] = field(default_factory=list)
    readout: list[tuple[str, Callable[[Array, float, Array], Array]]] = field(default_factory=list)
    sampled: list[tuple[str, Callable[[Array, Array], Array]]] = field(default_factory=list)
    converter: list[tuple[str, Callable[[Array], Array]]] = field(default_factory=list)


@dataclass(frozen=True)
class Truth:
    """Noise-free samples of one run, each (n,).

    `current` is the mean current through the heater over the interval that ends at the sample [A], `channels` the
    sensors' values, `temperature` that of the heated body [degC], `metal` and `structure` the fractions [1].
    """

    time: Array
    command: Array
    current: Array
    channels: Mapping[str, Array]
    temperature: Array
    metal: Array
    structure: Array
    reversals: int


Noise = dict[str, ChannelNoise]


def channels_of(device: Device) -> tuple[str, ...]:
    """Return the sensor channels of `device`, the logged current not among them."""
    channels: tuple[str, ...] = (RESISTANCE, TIP_DEFLECTION)
    return (*channels, STAGE_TEMPERATURE) if device.preset.has_temperature else channels


def simulate(device: Device, command: Array, plan: Plan, jitter: Array | None = None) -> Truth:
    """Run `device` on commanded currents (n,) [A]; `command[k]` acts from sample k to sample k + 1.

    With `jitter` (n,) [s], below half a period, the sensors are read that much after the instants of the commands.
    """
    preset = device.preset
    n, sub, step = command.size, preset.substeps, preset.sample_period / preset.substeps
    driven = np.repeat(np.clip(command[:-1], *preset.current_limits), sub)
    for drive in plan.driver:
        driven = drive(driven, step)
    start = np.arange(driven.size) * step
    delay = round((device.dead_time + plan.dead_time) / step)
    heating = np.concatenate([np.zeros(delay), driven])[: driven.size]
    ambient = device.ambient + sum((f(start) for f in plan.ambient), np.zeros(driven.size))
    power = device.gain * (heating**2 if preset.squared else heating)
    ambient = ambient + sum((f(power, step) for f in plan.heat), np.zeros(driven.size))
    local = sum((f(start) for f in plan.local), np.zeros(driven.size))
    shift = sum((f(start, driven) for f in plan.shift), np.zeros(driven.size))
    if plan.widening:
        device = replace(
            device, film=device.film._replace(structure=widen(device.film.structure, plan.widening))
        )
    body, film_temperature, metal, structure, reversals = run_core(
        device, Terms(**plan.terms), current=heating, ambient=ambient, local=local, shift=shift, step=step
    )
    for change in plan.phase:
        metal, structure = change(step, film_temperature, metal, structure, device)
    fine = np.arange(driven.size + 1) * step
    resistance = 10 ** log_resistance(device, metal, film_temperature)
    instant = np.concatenate([driven[:1] * 0, driven])
    for alter in plan.film:
        resistance = alter(fine, resistance, film_temperature, instant)
    deflection = static_deflection(device, structure, film_temperature)
    for bend in plan.structure:
        deflection = bend(fine, deflection, film_temperature, structure, device)
    values = {RESISTANCE: resistance, TIP_DEFLECTION: deflection, STAGE_TEMPERATURE: body}
    for channel, read in plan.readout:
        values[channel] = read(fine, step, values[channel])
    time = np.arange(n) * preset.sample_period
    if jitter is not None:
        time = np.clip(time + jitter, 0.0, fine[-1])
    sampled = {name: np.interp(time, fine, values[name]) for name in channels_of(device)}
    for channel, at_samples in plan.sampled:
        sampled[channel] = at_samples(time, sampled[channel])
    mean_current = np.concatenate([[0.0], driven.reshape(n - 1, sub).mean(axis=1)])
    return Truth(
        time,
        command,
        mean_current,
        sampled,
        body[::sub].copy(),
        metal[::sub].copy(),
        structure[::sub].copy(),
        reversals,
    )


def draw_rig_noise(rng: np.random.Generator, device: Device) -> Noise:
    """Draw the noise of every logged channel; that of the resistance is in log10 ohm."""
    preset = device.preset
    levels = {
        RESISTANCE: preset.noise_log_resistance,
        TIP_DEFLECTION: preset.noise_deflection,
        STAGE_TEMPERATURE: preset.noise_temperature,
    }
    noise = {name: draw_noise(rng, levels[name]) for name in channels_of(device)}
    noise[HEATER_CURRENT] = ChannelNoise(preset.noise_current, 0.0, 0.0)
    return noise


def log_channels(
    truth: Truth, plan: Plan, noise: Noise, rng: np.random.Generator, *, shunt: bool
) -> dict[str, Array]:
    """Return what the rig logs: channel -> (n,) in SI units.

    With `shunt` the heater current is measured (mean over the interval, with noise), else the set value is logged.
    """
    n = truth.time.size
    logged: dict[str, Array] = {}
    for name, values in truth.channels.items():
        disturbance = sample_noise(rng, noise[name], n)
        logged[name] = values * 10**disturbance if name == RESISTANCE else values + disturbance
    for channel, convert in plan.converter:
        logged[channel] = convert(logged[channel])
    shunt_noise = sample_noise(rng, noise[HEATER_CURRENT], n)
    set_value = np.concatenate([[0.0], truth.command[:-1]])
    logged[HEATER_CURRENT] = truth.current + shunt_noise if shunt else set_value
    return logged
