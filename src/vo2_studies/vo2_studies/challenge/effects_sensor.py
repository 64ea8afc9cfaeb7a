"""Effects of one sensor channel and its converter, written from their definitions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

from vo2_studies.challenge.effect import ANY, ConcealedEffect, Context, either_sign, log_uniform
from vo2_studies.challenge.filters import boxcar, lag
from vo2_studies.challenge.rig import Plan

__all__ = ["EFFECTS", "UNITS"]

Array = NDArray[np.floating]
Values = dict[str, float]
Draw = dict[str, tuple[float, str]]
UNITS = {RESISTANCE: "ohm", TIP_DEFLECTION: "m", STAGE_TEMPERATURE: "degC"}


def _apply_lag(plan: Plan, v: Values, c: Context, signal: str) -> None:
    plan.readout.append((signal, lambda t, step, y: lag(y, step, v["time_constant"])))


def _apply_average(plan: Plan, v: Values, c: Context, signal: str) -> None:
    length = v["length"]
    plan.readout.append((signal, lambda t, step, y: boxcar(y, step, length) if length > 0 else y))


def _apply_ripple(plan: Plan, v: Values, c: Context) -> None:
    wave = 2 * np.pi / v["period"]
    plan.readout.append((TIP_DEFLECTION, lambda t, step, y: y + v["amplitude"] * np.sin(wave * y)))


def _apply_late(plan: Plan, v: Values, c: Context, signal: str) -> None:
    plan.readout.append((signal, lambda t, step, y: np.interp(t - v["delay"], t, y)))


def _apply_gain(plan: Plan, v: Values, c: Context, signal: str) -> None:
    plan.sampled.append((signal, lambda t, y: y * (1 + v["rate"] * t)))


def _apply_zero(plan: Plan, v: Values, c: Context) -> None:
    plan.sampled.append((TIP_DEFLECTION, lambda t, y: y + v["rate"] * t))


def _draw_zero(c: Context) -> Draw:
    total = either_sign(c.rng, log_uniform(c.rng, 0.3e-6, 6e-6)) * c.preset.scales.deflection
    return {"rate": (total / c.duration, "m/s"), "total_change": (total, "m")}


def _draw_gain(c: Context) -> Draw:
    total = either_sign(c.rng, log_uniform(c.rng, 0.005, 0.1))
    return {"rate": (total / c.duration, "1/s"), "total_change": (total, "1")}


def _apply_clip(plan: Plan, v: Values, c: Context, signal: str) -> None:
    plan.converter.append((signal, lambda y: np.minimum(y, v["level"])))


def _draw_clip(c: Context, signal: str) -> Draw:
    if signal == RESISTANCE:
        level = c.preset.resistance[1] * float(c.rng.uniform(0.4, 0.85))
    elif signal == TIP_DEFLECTION:
        low, high = c.preset.deflection
        level = high - (high - low) * log_uniform(c.rng, 0.01, 0.2)
    else:
        level = c.preset.heating[0] + float(c.rng.uniform(0.0, 9.0))
    return {"level": (level, UNITS[signal])}


def _apply_quantise(plan: Plan, v: Values, c: Context, signal: str) -> None:
    bit = v["least_bit"]
    if bit > 0:
        # a converter never reads below one bit of a positive resistance
        floor = bit if signal == RESISTANCE else -np.inf
        plan.converter.append((signal, lambda y: np.maximum(np.round(y / bit) * bit, floor)))


def _draw_quantise(c: Context, signal: str) -> Draw:
    if signal == RESISTANCE:
        bit = c.preset.resistance[0] * log_uniform(c.rng, 0.05, 0.8)
    elif signal == TIP_DEFLECTION:
        bit = c.preset.noise_deflection * log_uniform(c.rng, 8, 60)
    else:
        bit = c.preset.noise_temperature * log_uniform(c.rng, 10, 60)
    unit = "K" if signal == STAGE_TEMPERATURE else UNITS[signal]
    return {"least_bit": (bit, unit)}


EFFECTS = (
    ConcealedEffect(
        "sensor_lag",
        ANY,
        lambda c, signal: {"time_constant": (c.seconds((0.1e-3, 4e-3), (0.1, 4.0)), "s")},
        _apply_lag,
        {"time_constant": 0.0},
        per_signal=True,
    ),
    ConcealedEffect(
        "clock_offset",
        ANY,
        lambda c, signal: {"delay": (c.seconds((0.1e-3, 4e-3), (0.1, 4.0)), "s")},
        _apply_late,
        {"delay": 0.0},
        per_signal=True,
    ),
    ConcealedEffect(
        "sensor_gain_drift", ANY, lambda c, signal: _draw_gain(c), _apply_gain, {"rate": 0.0}, per_signal=True
    ),
    ConcealedEffect("sensor_zero_drift", ANY, _draw_zero, _apply_zero, {"rate": 0.0}),
    ConcealedEffect("adc_saturation", ANY, _draw_clip, _apply_clip, {"level": 1e12}, per_signal=True),
    ConcealedEffect(
        "adc_quantization", ANY, _draw_quantise, _apply_quantise, {"least_bit": 0.0}, per_signal=True
    ),
    ConcealedEffect(
        "averaging",
        ANY,
        lambda c, signal: {"length": (c.seconds((0.3e-3, 10e-3), (0.3, 10.0)), "s")},
        _apply_average,
        {"length": 0.0},
        per_signal=True,
    ),
    # interference of the reading laser: an error periodic in the deflection itself
    ConcealedEffect(
        "sensor_ripple",
        ANY,
        lambda c: {
            "amplitude": (c.preset.noise_deflection * log_uniform(c.rng, 6, 20), "m"),
            "period": (float(c.rng.uniform(8e-6, 20e-6)) * c.preset.scales.deflection, "m"),
        },
        _apply_ripple,
        {"amplitude": 0.0},
    ),
)
