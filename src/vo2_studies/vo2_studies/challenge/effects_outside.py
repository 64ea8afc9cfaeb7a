"""Things that happen to rigs and are in nobody's catalogue: the right answer to them is "unknown"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import TIP_DEFLECTION

from vo2_studies.challenge.devices import Device
from vo2_studies.challenge.effect import ANY, ConcealedEffect, Context, log_uniform
from vo2_studies.challenge.filters import backlash
from vo2_studies.challenge.rig import Plan

__all__ = ["OUTSIDE"]

Array = NDArray[np.floating]
Values = dict[str, float]
Draw = dict[str, tuple[float, str]]


def _hum(plan: Plan, v: Values, c: Context) -> None:
    wave = 2 * np.pi * v["frequency"]
    plan.sampled.append((TIP_DEFLECTION, lambda t, y: y + v["amplitude"] * np.sin(wave * t + v["phase"])))


def _draw_hum(c: Context) -> Draw:
    return {
        "amplitude": (c.preset.noise_deflection * log_uniform(c.rng, 6, 40), "m"),
        "frequency": (float(c.rng.uniform(20, 300) if c.quick else c.rng.uniform(0.2, 2.5)), "Hz"),
        "phase": (float(c.rng.uniform(0, 6.28)), "rad"),
    }


def _humidity(plan: Plan, v: Values, c: Context) -> None:
    def absorb(t: Array, resistance: Array, temperature: Array, current: Array) -> Array:
        wet = np.sqrt(np.maximum(t - v["onset"], 0) / c.duration)
        return resistance * 10 ** (v["decades"] * wet)

    plan.film.append(absorb)


def _draw_humidity(c: Context) -> Draw:
    return {
        "decades": (-log_uniform(c.rng, 0.008, 0.06), "1"),
        "onset": (c.duration * float(c.rng.uniform(0.2, 0.7)), "s"),
    }


def _stiction(plan: Plan, v: Values, c: Context) -> None:
    def stick(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        return backlash(deflection, v["half_width"])

    plan.structure.append(stick)


def _fringe(plan: Plan, v: Values, c: Context) -> None:
    wave = 2 * np.pi / v["period"]
    plan.readout.append((TIP_DEFLECTION, lambda t, step, y: y + v["amplitude"] * np.sin(wave * y)))


def _readout_gain(plan: Plan, v: Values, c: Context) -> None:
    middle = c.place(0.5)

    def warp(t: Array, resistance: Array, temperature: Array, current: Array) -> Array:
        return resistance * 10 ** (v["decades"] * np.sin((temperature - middle) / v["period"] * 2 * np.pi))

    plan.film.append(warp)


def _duffing(plan: Plan, v: Values, c: Context) -> None:
    low, high = c.preset.deflection

    def stiffen(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        # static Duffing spring x + a x^3 = f, first order in a, x from the middle of the range
        x = 2 * (deflection - (low + high) / 2) / (high - low)
        return deflection - v["cubic"] * (high - low) / 2 * x**3

    plan.structure.append(stiffen)


def _neighbour(plan: Plan, v: Values, c: Context) -> None:
    plan.ambient.append(lambda t: v["rise"] * (np.mod(t + v["phase"], v["period"]) < v["period"] / 2))


def _draw_neighbour(c: Context) -> Draw:
    period = log_uniform(c.rng, 0.15, 0.8) if c.quick else log_uniform(c.rng, 60, 200)
    return {
        "rise": (log_uniform(c.rng, 0.15, 2.0), "K"),
        "period": (period, "s"),
        "phase": (float(c.rng.uniform(0, period)), "s"),
    }


def _telegraph(plan: Plan, v: Values, c: Context) -> None:
    rng = np.random.default_rng(int(v["pattern"]))
    dwell, ends = v["dwell"], []
    total = 0.0
    while total < 3 * c.duration:
        total += rng.exponential(dwell)
        ends.append(total)

    def jump(t: Array, resistance: Array, temperature: Array, current: Array) -> Array:
        state = np.searchsorted(np.asarray(ends), t) % 2
        return resistance * 10 ** (v["decades"] * state)

    plan.film.append(jump)


def _draw_telegraph(c: Context) -> Draw:
    return {
        "decades": (log_uniform(c.rng, 0.008, 0.05), "1"),
        "dwell": (c.duration * log_uniform(c.rng, 0.004, 0.04), "s"),
        "pattern": (float(c.rng.integers(1, 2**31)), "1"),
    }


def _ripple(plan: Plan, v: Values, c: Context) -> None:
    wave = 2 * np.pi * v["frequency"]
    plan.driver.append(lambda i, step: i * (1 + v["share"] * np.sin(wave * step * np.arange(i.size))))


def _draw_ripple(c: Context) -> Draw:
    return {
        "share": (log_uniform(c.rng, 0.004, 0.04), "1"),
        "frequency": (float(c.rng.uniform(20, 130) if c.quick else c.rng.uniform(0.01, 0.05)), "Hz"),
    }


def _inclusion(plan: Plan, v: Values, c: Context) -> None:
    def second(t: Array, resistance: Array, temperature: Array, current: Array) -> Array:
        done = 1 / (1 + np.exp(-np.clip((temperature - v["temperature"]) / v["width"], -50, 50)))
        return resistance * 10 ** (-v["decades"] * done)

    plan.film.append(second)


OUTSIDE = (
    ConcealedEffect("mains_hum", ANY, _draw_hum, _hum, {"amplitude": 0.0}),
    ConcealedEffect("humidity", ANY, _draw_humidity, _humidity, {"decades": 0.0}),
    ConcealedEffect(
        "stiction",
        ANY,
        lambda c: {"half_width": (c.preset.noise_deflection * log_uniform(c.rng, 6, 40), "m")},
        _stiction,
        {"half_width": 0.0},
    ),
    # interference of the reading laser: an error periodic in the deflection itself
    ConcealedEffect(
        "interference_fringe",
        ANY,
        lambda c: {
            "amplitude": (c.preset.noise_deflection * log_uniform(c.rng, 6, 20), "m"),
            "period": (float(c.rng.uniform(8e-6, 20e-6)), "m"),
        },
        _fringe,
        {"amplitude": 0.0},
    ),
    ConcealedEffect(
        "readout_temperature",
        ANY,
        lambda c: {
            "decades": (log_uniform(c.rng, 0.006, 0.04), "1"),
            "period": (float(c.rng.uniform(18, 35)), "K"),
        },
        _readout_gain,
        {"decades": 0.0},
    ),
    ConcealedEffect(
        "duffing_spring",
        ANY,
        lambda c: {"cubic": (log_uniform(c.rng, 0.008, 0.08), "1")},
        _duffing,
        {"cubic": 0.0},
    ),
    ConcealedEffect("neighbour_heater", ANY, _draw_neighbour, _neighbour, {"rise": 0.0}),
    ConcealedEffect("telegraph_noise", ANY, _draw_telegraph, _telegraph, {"decades": 0.0}),
    ConcealedEffect("supply_ripple", ANY, _draw_ripple, _ripple, {"share": 0.0}, needs_set_value=True),
    # a doped or strained region with a transition of its own, without loop
    ConcealedEffect(
        "second_inclusion",
        ANY,
        lambda c: {
            "decades": (log_uniform(c.rng, 0.008, 0.06), "1"),
            "temperature": (float(c.rng.uniform(43, 49)), "degC"),
            "width": (float(c.rng.uniform(0.6, 2.0)), "K"),
        },
        _inclusion,
        {"decades": 0.0},
    ),
)
