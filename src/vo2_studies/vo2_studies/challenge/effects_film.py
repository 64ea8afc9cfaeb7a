"""Effects of the phase transition, the structure and the film's resistance, written from their sources."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_studies.challenge.devices import Device
from vo2_studies.challenge.effect import ANY, ConcealedEffect, Context, either_sign, log_uniform
from vo2_studies.challenge.families import major_loop
from vo2_studies.challenge.filters import after_steps, backlash, lag, log_relaxation, oscillator
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
    strength = log_uniform(c.rng, 0.003, 0.04) * (1 if c.quick else 3)
    return {"strength": (strength, "1"), "onset": (c.seconds((4e-3, 50e-3), (2.0, 15.0)), "s")}


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
    frequency = 1 / c.seconds((1 / 320, 1 / 25), (1 / 2.0, 1 / 0.12))
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


def _apply_widening(plan: Plan, v: Values, c: Context) -> None:
    plan.widening += v["width"]


def _apply_log_creep(plan: Plan, v: Values, c: Context) -> None:
    def bend(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        return deflection + v["share"] * after_steps(deflection, np.log1p(t / v["onset"]))

    plan.structure.append(bend)


def _apply_backlash(plan: Plan, v: Values, c: Context) -> None:
    plan.structure.append(lambda t, deflection, *_: backlash(deflection, v["half_width"]))


def _apply_stiffening(plan: Plan, v: Values, c: Context) -> None:
    low, high = c.preset.deflection

    def stiffen(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
        # static Duffing spring x + a x^3 = f, first order in a, x from the middle of the range
        x = 2 * (deflection - (low + high) / 2) / (high - low)
        return deflection - v["cubic"] * (high - low) / 2 * x**3

    plan.structure.append(stiffen)


def _apply_thermovoltage(plan: Plan, v: Values, c: Context) -> None:
    floor, ambient = 0.2 * c.preset.resistance[0], c.device.ambient
    plan.film.append(
        lambda t, resistance, temperature, current: np.maximum(
            resistance + v["slope"] * (temperature - ambient), floor
        )
    )


def _draw_thermovoltage(c: Context) -> Draw:
    # Seebeck voltage over the sense current: a few per cent of the metallic resistance at 50 K
    slope = log_uniform(c.rng, 0.008, 0.2) * c.preset.resistance[0] / 50.0
    return {"slope": (either_sign(c.rng, slope), "ohm/K")}


def _apply_contact(plan: Plan, v: Values, c: Context) -> None:
    plan.film.append(lambda t, resistance, temperature, current: resistance + v["rate"] * t)


def _draw_contact(c: Context) -> Draw:
    total = log_uniform(c.rng, 0.02, 0.5) * c.preset.resistance[0]
    return {"rate": (total / c.duration, "ohm/s"), "total_change": (total, "ohm")}


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
            "time_constant": (c.seconds((0.1e-3, 5e-3), (0.08, 4.0)), "s"),
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
        lambda c: {
            "slope_change": (
                either_sign(c.rng, log_uniform(c.rng, 0.004e-6, 0.1e-6) * c.preset.scales.deflection),
                "m/K",
            )
        },
        _apply_expansion,
        {"slope_change": 0.0},
    ),
    ConcealedEffect(
        "creep",
        ANY,
        lambda c: {
            "share": (log_uniform(c.rng, 0.004, 0.06), "1"),
            "time_constant": (c.seconds((0.1, 1.5), (25, 200)), "s"),
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
    ConcealedEffect(
        "loop_width_difference",
        ANY,
        lambda c: {"width": (either_sign(c.rng, log_uniform(c.rng, 0.1, 2.0)), "K")},
        _apply_widening,
        {"width": 0.0},
    ),
    # Sharrock, J. Appl. Phys. 76, 6413, 1994: the coercivity grows with the logarithm of the rate.
    ConcealedEffect(
        "rate_dependent_width",
        ANY,
        lambda c: {
            "per_e_fold": (log_uniform(c.rng, 0.02, 0.4), "K"),
            "onset": (log_uniform(c.rng, 0.1, 3.0) / c.preset.time_constant, "K/s"),
        },
        _terms(overdrive="per_e_fold", overdrive_rate="onset"),
        {"per_e_fold": 0.0},
    ),
    # Akin to amorphous films and piezoceramics: strain grows with the logarithm of the time since each step.
    ConcealedEffect(
        "log_creep",
        ANY,
        lambda c: {
            "share": (log_uniform(c.rng, 0.001, 0.015), "1"),
            "onset": (c.seconds((0.01, 0.1), (4, 40)), "s"),
        },
        _apply_log_creep,
        {"share": 0.0},
    ),
    ConcealedEffect(
        "backlash",
        ANY,
        lambda c: {"half_width": (c.preset.noise_deflection * log_uniform(c.rng, 6, 40), "m")},
        _apply_backlash,
        {"half_width": 0.0},
    ),
    ConcealedEffect(
        "stiffening",
        ANY,
        lambda c: {"cubic": (log_uniform(c.rng, 0.008, 0.08), "1")},
        _apply_stiffening,
        {"cubic": 0.0},
    ),
    ConcealedEffect("thermovoltage", ANY, _draw_thermovoltage, _apply_thermovoltage, {"slope": 0.0}),
    ConcealedEffect("contact_drift", ANY, _draw_contact, _apply_contact, {"rate": 0.0}),
)
