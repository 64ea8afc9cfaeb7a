"""The same physics in forms that no catalogue writes first: what must be found is the cause, not the formula."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import TIP_DEFLECTION

from vo2_studies.challenge.devices import Device
from vo2_studies.challenge.effect import ANY, ConcealedEffect, Context, either_sign, log_uniform
from vo2_studies.challenge.filters import lag
from vo2_studies.challenge.rig import Plan

__all__ = ["EFFECTS"]

Array = NDArray[np.floating]
Values = dict[str, float]
Draw = dict[str, tuple[float, str]]
KNOTS = 40
"""Steps of a random walk over the recording; between them a straight line."""


def _walk(v: Values, c: Context, t: Array) -> Array:
    """Return a random walk (n,) along times t (n,) [s] with the range `total_change`; its pace outlasts the recording."""
    steps = np.random.default_rng(int(v["pattern"])).standard_normal(4 * KNOTS)
    walk = np.concatenate([[0.0], np.cumsum(steps)])
    walk /= np.ptp(walk[: KNOTS + 1])
    return v["total_change"] * np.interp(t, np.arange(walk.size) * c.duration / KNOTS, walk)


def _pattern(c: Context, total: float, unit: str) -> Draw:
    return {"total_change": (total, unit), "pattern": (float(c.rng.integers(1, 2**31)), "1")}


def _room_wave(plan: Plan, v: Values, c: Context) -> None:
    plan.ambient.append(lambda t: v["amplitude"] * np.sin(2 * np.pi * t / v["period"] + v["phase"]))


def _draw_room_wave(c: Context) -> Draw:
    return {
        "amplitude": (log_uniform(c.rng, 0.1, 1.5), "K"),
        "period": (c.duration * log_uniform(c.rng, 0.15, 1.5), "s"),
        "phase": (float(c.rng.uniform(0, 2 * np.pi)), "rad"),
    }


def _room_walk(plan: Plan, v: Values, c: Context) -> None:
    plan.ambient.append(lambda t: _walk(v, c, t))


def _modes(plan: Plan, v: Values, c: Context) -> None:
    def ladder(power: Array, step: float) -> Array:
        # equal shares, time constants a factor of 5 apart
        times = v["time_constant"] * 5.0 ** np.arange(-1, 2)
        return v["gain"] / 3 * np.sum([lag(power, step, time) for time in times], axis=0)

    plan.heat.append(ladder)


def _two_creeps(plan: Plan, v: Values, c: Context) -> None:
    def bend(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        step = float(t[1] - t[0])
        slow = sum(
            lag(deflection, step, v["time_constant"] * factor) - deflection[0] for factor in (0.3, 3.0)
        )
        return deflection + v["share"] / 2 * slow

    plan.structure.append(bend)


def _gain_walk(plan: Plan, v: Values, c: Context, signal: str) -> None:
    plan.sampled.append((signal, lambda t, y: y * (1 + _walk(v, c, t))))


def _zero_walk(plan: Plan, v: Values, c: Context) -> None:
    plan.sampled.append((TIP_DEFLECTION, lambda t, y: y + _walk(v, c, t)))


def _contact_walk(plan: Plan, v: Values, c: Context) -> None:
    plan.film.append(lambda t, resistance, temperature, current: resistance + np.abs(_walk(v, c, t)))


EFFECTS = (
    ConcealedEffect(
        "ambient_drift", ANY, _draw_room_wave, _room_wave, {"amplitude": 0.0}, form="sinusoidal room"
    ),
    ConcealedEffect(
        "ambient_drift",
        ANY,
        lambda c: _pattern(c, log_uniform(c.rng, 0.15, 2.5), "K"),
        _room_walk,
        {"total_change": 0.0},
        form="random walk of the room",
    ),
    ConcealedEffect(
        "second_thermal_mode",
        ANY,
        lambda c: {
            "gain": (log_uniform(c.rng, 0.01, 0.1), "1"),
            "time_constant": (c.seconds((0.05, 0.3), (80, 200)), "s"),
        },
        _modes,
        {"gain": 0.0},
        form="three thermal modes",
        siblings=("substrate_diffusion",),
    ),
    ConcealedEffect(
        "creep",
        ANY,
        lambda c: {
            "share": (log_uniform(c.rng, 0.006, 0.08), "1"),
            "time_constant": (c.seconds((0.1, 1.0), (25, 150)), "s"),
        },
        _two_creeps,
        {"share": 0.0},
        form="two exponentials",
        siblings=("log_creep",),
    ),
    ConcealedEffect(
        "sensor_gain_drift",
        ANY,
        lambda c, signal: _pattern(c, either_sign(c.rng, log_uniform(c.rng, 0.01, 0.1)), "1"),
        _gain_walk,
        {"total_change": 0.0},
        per_signal=True,
        form="random walk of the gain",
    ),
    ConcealedEffect(
        "sensor_zero_drift",
        ANY,
        lambda c: _pattern(
            c, either_sign(c.rng, log_uniform(c.rng, 0.3e-6, 6e-6)) * c.preset.scales.deflection, "m"
        ),
        _zero_walk,
        {"total_change": 0.0},
        form="random walk of the zero",
    ),
    ConcealedEffect(
        "contact_drift",
        ANY,
        lambda c: _pattern(c, log_uniform(c.rng, 0.03, 0.5) * c.preset.resistance[0], "ohm"),
        _contact_walk,
        {"total_change": 0.0},
        form="random walk of the contact",
    ),
)
