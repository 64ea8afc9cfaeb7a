"""Effects between the command and the heater's current, written from their definitions."""

from __future__ import annotations

import numpy as np

from vo2_studies.challenge.effect import ANY, ConcealedEffect, Context, either_sign, log_uniform
from vo2_studies.challenge.filters import rate_limit
from vo2_studies.challenge.rig import Plan

__all__ = ["EFFECTS"]

Values = dict[str, float]
Draw = dict[str, tuple[float, str]]


def _apply_saturation(plan: Plan, v: Values, c: Context) -> None:
    limit = v["limit"]
    plan.driver.append(lambda i, step: np.clip(i, -limit, limit))


def _draw_saturation(c: Context) -> Draw:
    largest = max(abs(i) for i in (c.preset.operating if c.quick else c.preset.current_limits))
    return {"limit": (largest * (1 - log_uniform(c.rng, 0.03 if c.quick else 0.004, 0.3)), "A")}


def _apply_slew(plan: Plan, v: Values, c: Context) -> None:
    plan.driver.append(lambda i, step: rate_limit(i, v["slew_rate"] * step))


def _apply_deadzone(plan: Plan, v: Values, c: Context) -> None:
    width = v["half_width"]
    plan.driver.append(lambda i, step: np.sign(i) * np.maximum(np.abs(i) - width, 0.0))


def _apply_gain(plan: Plan, v: Values, c: Context) -> None:
    plan.driver.append(lambda i, step: i * (1 + v["rate"] * step * np.arange(i.size)))


def _apply_ageing(plan: Plan, v: Values, c: Context) -> None:
    def age(i: np.ndarray, step: float) -> np.ndarray:
        return i * (1 + v["total_change"] * -np.expm1(-step * np.arange(i.size) / v["time_constant"]))

    plan.driver.append(age)


def _draw_gain(c: Context) -> Draw:
    total = either_sign(c.rng, log_uniform(c.rng, 0.002, 0.03))
    return {"rate": (total / c.duration, "1/s"), "total_change": (total, "1")}


def _draw_ageing(c: Context) -> Draw:
    total = either_sign(c.rng, log_uniform(c.rng, 0.003, 0.03))
    return {"total_change": (total, "1"), "time_constant": (c.duration * c.rng.uniform(0.1, 0.6), "s")}


def _apply_compression(plan: Plan, v: Values, c: Context) -> None:
    largest = max(abs(i) for i in c.preset.operating)
    plan.driver.append(lambda i, step: i * (1 - v["share"] * np.abs(i / largest) ** v["power"]))


def _draw_compression(c: Context) -> Draw:
    return {"share": (log_uniform(c.rng, 0.002, 0.05), "1"), "power": (float(c.rng.uniform(2.0, 6.0)), "1")}


EFFECTS = (
    ConcealedEffect(
        "driver_saturation", ANY, _draw_saturation, _apply_saturation, {"limit": 1e9}, driver=True
    ),
    ConcealedEffect(
        "driver_slew",
        ANY,
        lambda c: {"slew_rate": (c.amperes((0.5, 10.0), (0.04, 1.0)) / c.preset.scales.time, "A/s")},
        _apply_slew,
        {"slew_rate": 1e9},
        driver=True,
    ),
    ConcealedEffect(
        "driver_deadzone",
        ANY,
        lambda c: {"half_width": (c.amperes((0.008e-3, 0.2e-3), (0.0015, 0.04)), "A")},
        _apply_deadzone,
        {"half_width": 0.0},
        driver=True,
    ),
    ConcealedEffect(
        "drive_gain_drift", ANY, _draw_gain, _apply_gain, {"rate": 0.0}, driver=True, needs_set_value=True
    ),
    ConcealedEffect(
        "drive_gain_drift",
        ANY,
        _draw_ageing,
        _apply_ageing,
        {"total_change": 0.0},
        driver=True,
        needs_set_value=True,
        form="ageing towards a limit",
    ),
    # the source's output falls short as its compliance nears
    ConcealedEffect(
        "source_compression",
        ANY,
        _draw_compression,
        _apply_compression,
        {"share": 0.0},
        driver=True,
        needs_set_value=True,
    ),
)
