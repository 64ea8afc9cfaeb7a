"""Effects of the phase transition, the structure and the film's resistance, written from their sources."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_studies.challenge.devices import Device
from vo2_studies.challenge.effect import ANY, ConcealedEffect, Context, either_sign, log_uniform
from vo2_studies.challenge.families import major_loop
from vo2_studies.challenge.filters import lag, log_relaxation, oscillator
from vo2_studies.challenge.rig import Plan

__all__ = ["EFFECTS"]

Array = NDArray[np.floating]
Values = dict[str, float]
Draw = dict[str, tuple[float, str]]
ERASE = 0.3
"""Temperature movement over which the after-effect of a hold is forgotten [K]."""


def _apply_relaxation(plan: Plan, v: Values, c: Context) -> None:
    def drift(step: float, temperature: Array, metal: Array, structure: Array, device: Device):
        x = log_relaxation(temperature, step, v["strength"], v["onset"], ERASE)
        return tuple(np.clip(s + 4 * s * (1 - s) * x, 0.0, 1.0) for s in (metal, structure))

    plan.phase.append(drift)


def _draw_relaxation(c: Context) -> Draw:
    onset = log_uniform(c.rng, 4e-3, 50e-3) if c.quick else log_uniform(c.rng, 2.0, 15.0)
    return {"strength": (log_uniform(c.rng, 0.003, 0.04) * (1 if c.quick else 3), "1"), "onset": (onset, "s")}


def _apply_reversible(plan: Plan, v: Values, c: Context) -> None:
    grid = np.linspace(c.device.ambient - 30, c.device.hot_temperature + 40, 2000)
    up_m, down_m, up_s, down_s = major_loop(c.device.film, grid)
    share = v["reversible_share"]

    def mix(step: float, temperature: Array, metal: Array, structure: Array, device: Device):
        # Jiles and Atherton, J. Magn. Magn. Mater. 61, 48, 1986: s = (1 - c) s_irr + c s_an
        return (
            (1 - share) * metal + share * np.interp(temperature, grid, (up_m + down_m) / 2),
            (1 - share) * structure + share * np.interp(temperature, grid, (up_s + down_s) / 2),
        )

    plan.phase.append(mix)


def _apply_expansion(plan: Plan, v: Values, c: Context) -> None:
    change = v["slope_change"]

    def bend(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        return deflection - change * structure * (temperature - device.ambient)

    plan.structure.append(bend)


def _apply_creep(plan: Plan, v: Values, c: Context) -> None:
    def bend(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        # Kelvin-Voigt element in series: its strain follows the instantaneous one slowly
        return deflection + v["share"] * (
            lag(deflection, float(t[1] - t[0]), v["time_constant"]) - deflection[0]
        )

    plan.structure.append(bend)


def _apply_resonance(plan: Plan, v: Values, c: Context) -> None:
    def bend(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        if v["frequency"] <= 0:
            return deflection
        return oscillator(deflection, float(t[1] - t[0]), v["frequency"], v["damping_ratio"])

    plan.structure.append(bend)


def _draw_resonance(c: Context) -> Draw:
    frequency = log_uniform(c.rng, 25, 320) if c.quick else log_uniform(c.rng, 0.12, 2.0)
    return {"frequency": (frequency, "Hz"), "damping_ratio": (log_uniform(c.rng, 0.004, 0.05), "1")}


def _apply_series(plan: Plan, v: Values, c: Context) -> None:
    plan.film.append(lambda t, resistance, temperature, current: resistance + v["resistance"])


def _apply_leakage(plan: Plan, v: Values, c: Context) -> None:
    conductance = v["conductance"]
    plan.film.append(lambda t, resistance, temperature, current: resistance / (1 + conductance * resistance))


def _draw_leakage(c: Context) -> Draw:
    conductance = log_uniform(c.rng, 0.008, 0.3) / c.preset.resistance[1]
    return {"conductance": (conductance, "S"), "resistance": (1 / conductance, "ohm")}


def _apply_crosstalk(plan: Plan, v: Values, c: Context) -> None:
    coupling = v["coupling"]
    floor = 0.2 * c.preset.resistance[0]
    plan.film.append(
        lambda t, resistance, temperature, current: np.maximum(resistance + coupling * current, floor)
    )


def _draw_crosstalk(c: Context) -> Draw:
    largest = max(abs(i) for i in c.preset.operating)
    volume = log_uniform(c.rng, 0.008, 0.15) * c.preset.resistance[0]
    return {"coupling": (either_sign(c.rng, volume / largest), "ohm/A")}


def _terms(**names: str):
    """Return an `apply` that copies parameters into core terms, term=parameter."""

    def apply(plan: Plan, v: Values, c: Context) -> None:
        plan.terms |= {term: v[name] for term, name in names.items()}

    return apply


EFFECTS = (
    # First-order kinetics towards the quasi-static fraction: tau_k ds/dt = s_eq - s.
    ConcealedEffect(
        "transition_kinetics",
        ANY,
        lambda c: {
            "time_constant": (
                log_uniform(c.rng, 0.1e-3, 5e-3) if c.quick else log_uniform(c.rng, 0.08, 4.0),
                "s",
            )
        },
        _terms(kinetic_time="time_constant"),
        {"time_constant": 0.0},
    ),
    ConcealedEffect(
        "transition_offset",
        ANY,
        lambda c: {"shift": (either_sign(c.rng, log_uniform(c.rng, 0.05, 1.5)), "K")},
        _terms(structure_offset="shift"),
        {"shift": 0.0},
    ),
    # Moving model, Della Torre, IEEE Trans. Audio Electroacoust. 14, 86, 1966: the grains see T + kappa (s - 1/2).
    ConcealedEffect(
        "minor_loop_incongruency",
        ANY,
        lambda c: {"kappa": (either_sign(c.rng, log_uniform(c.rng, 0.12, 2.5)), "K")},
        _terms(feedback="kappa"),
        {"kappa": 0.0},
    ),
    ConcealedEffect(
        "training_drift",
        ANY,
        lambda c: {
            "shift_per_reversal": (
                either_sign(c.rng, log_uniform(c.rng, 0.0004, 0.01) * (1 if c.quick else 4)),
                "K",
            )
        },
        _terms(training="shift_per_reversal"),
        {"shift_per_reversal": 0.0},
    ),
    ConcealedEffect("slow_relaxation", ANY, _draw_relaxation, _apply_relaxation, {"strength": 0.0}),
    ConcealedEffect(
        "non_hysteretic_branches",
        ANY,
        lambda c: {"reversible_share": (log_uniform(c.rng, 0.015, 0.25), "1")},
        _apply_reversible,
        {"reversible_share": 0.0},
    ),
    # (5.7): the expansion coefficient of the rutile phase differs, weighted with the true (hysteretic) fraction.
    ConcealedEffect(
        "phase_dependent_expansion",
        ANY,
        lambda c: {"slope_change": (either_sign(c.rng, log_uniform(c.rng, 0.004e-6, 0.1e-6)), "m/K")},
        _apply_expansion,
        {"slope_change": 0.0},
    ),
    ConcealedEffect(
        "creep",
        ANY,
        lambda c: {
            "share": (log_uniform(c.rng, 0.004, 0.06), "1"),
            "time_constant": (log_uniform(c.rng, 0.1, 1.5) if c.quick else log_uniform(c.rng, 25, 200), "s"),
        },
        _apply_creep,
        {"share": 0.0},
    ),
    ConcealedEffect("cantilever_resonance", ANY, _draw_resonance, _apply_resonance, {"frequency": 0.0}),
    ConcealedEffect(
        "series_resistance",
        ANY,
        lambda c: {"resistance": (log_uniform(c.rng, 0.01, 0.25) * c.preset.resistance[0], "ohm")},
        _apply_series,
        {"resistance": 0.0},
    ),
    ConcealedEffect("leakage_resistance", ANY, _draw_leakage, _apply_leakage, {"conductance": 0.0}),
    # Common return or capacitive pick-up of the heater line: R + chi i, at once.
    ConcealedEffect("current_crosstalk", ANY, _draw_crosstalk, _apply_crosstalk, {"coupling": 0.0}),
)
