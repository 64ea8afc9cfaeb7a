"""Effects of heat flow, written from their sources.

Every entry's `draw` returns parameters as name -> (value, unit); `apply` puts them into a `Plan`. `T` below is the
temperature of the heated body, `T0` ambient, `P` the nominal heat input in kelvin.
"""

from __future__ import annotations

import numpy as np

from vo2_studies.challenge.effect import (
    ANY,
    INTEGRATED,
    PELTIER,
    ConcealedEffect,
    Context,
    log_uniform,
)
from vo2_studies.challenge.effect import either_sign as signed
from vo2_studies.challenge.filters import half_order
from vo2_studies.challenge.rig import Plan

__all__ = ["EFFECTS"]

Values = dict[str, float]
Draw = dict[str, tuple[float, str]]


def _second_mode(c: Context) -> Draw:
    return {
        "gain": (log_uniform(c.rng, 0.006, 0.08), "1"),
        "time_constant": (c.seconds((0.03, 0.5), (80, 300)), "s"),
    }


def _apply_second_mode(plan: Plan, v: Values, c: Context) -> None:
    plan.terms |= {"slow_gain": v["gain"], "slow_time": v["time_constant"]}


def _apply_diffusion(plan: Plan, v: Values, c: Context) -> None:
    plan.heat.append(lambda power, step: v["gain"] * half_order(power, step, v["time_constant"]))


def _apply_dead_time(plan: Plan, v: Values, c: Context) -> None:
    plan.dead_time += v["delay"]


def _draw_dead_time(c: Context) -> Draw:
    # a whole number of integration steps, so that the drawn value is the one at work
    step = c.preset.sample_period / c.preset.substeps
    return {"delay": (max(1, round(c.seconds((0.125e-3, 2e-3), (0.06, 1.5)) / step)) * step, "s")}


def _apply_ambient(plan: Plan, v: Values, c: Context) -> None:
    rate, curve, duration = v["rate"], v["curvature"], c.duration
    plan.ambient.append(lambda t: rate * t * (1 + curve * (t / duration - 1)))


def _draw_ambient(c: Context) -> Draw:
    total = signed(c.rng, log_uniform(c.rng, 0.08, 2.5))
    curvature = float(c.rng.choice([0.0, c.rng.uniform(-0.8, 0.8)]))
    return {
        "rate": (total / c.duration, "K/s"),
        "curvature": (curvature, "1"),
        "initial_rate": (total / c.duration * (1 - curvature), "K/s"),
        "total_change": (total, "K"),
    }


def _draw_cooling(c: Context) -> Draw:
    change = log_uniform(c.rng, 0.05, 0.6) if c.quick else log_uniform(c.rng, 0.008, 0.35)
    return {"ratio": (1 + change, "1"), "change": (change, "1")}


def _draw_loss(c: Context) -> Draw:
    power = float(c.rng.uniform(1.25, 4.5))
    share = log_uniform(c.rng, 0.002, 0.05)
    return {
        "beta": (share * 60 ** (1 - power), "K^(1-n)"),
        "power": (power, "1"),
        "share_at_60K": (share, "1"),
    }


def _apply_laser(plan: Plan, v: Values, c: Context) -> None:
    rise, on, off = v["rise"], v["switched_on"], v["switched_off"]

    def heat(t: np.ndarray) -> np.ndarray:
        return rise * ((t >= on) & (t < off))

    # chapter 5: the laser heats cantilever and film, the stage's sensor beneath does not see it
    (plan.local if c.preset.has_temperature else plan.ambient).append(heat)


def _draw_laser(c: Context) -> Draw:
    if c.rng.random() < 0.5:
        on, off = 0.0, 2 * c.duration
    else:
        on, off = c.duration * c.rng.uniform(0.15, 0.45), c.duration * c.rng.uniform(0.6, 0.9)
    return {
        "rise": (log_uniform(c.rng, 0.15, 2.5), "K"),
        "switched_on": (on, "s"),
        "switched_off": (off, "s"),
    }


def _draw_sense(c: Context) -> Draw:
    rise = log_uniform(c.rng, 0.15, 3.0)
    return {"rise_per_ohm": (rise / c.preset.resistance[1], "K/ohm"), "rise_at_cold": (rise, "K")}


def _draw_peltier(c: Context) -> Draw:
    # pumped heat is S T i with T absolute: the gain K changes by 1/298 a kelvin, here 1/6 of K in 50 K/A
    return {
        "joule": (log_uniform(c.rng, 0.05, 2.5) / c.preset.scales.current**2, "K/A^2"),
        "pumping": (log_uniform(c.rng, 0.001, 0.05) / c.preset.scales.current, "1/A"),
    }


def _terms(**names: str):
    """Return an `apply` that copies parameters into core terms, term=parameter."""

    def apply(plan: Plan, v: Values, c: Context) -> None:
        plan.terms |= {term: v[name] for term, name in names.items()}

    return apply


EFFECTS = (
    # Two-time-constant (Foster) thermal network: a parallel pole of the support, Szekely 1988.
    ConcealedEffect("second_thermal_mode", ANY, _second_mode, _apply_second_mode, {"gain": 0.0}),
    # Transport delay, (8.1).
    ConcealedEffect("dead_time", ANY, _draw_dead_time, _apply_dead_time, {"delay": 0.0}),
    # Table 8.1: 20.8 and 22.6 s heating, 27.4 and 28.2 s cooling.
    ConcealedEffect(
        "cooling_asymmetry",
        ANY,
        _draw_cooling,
        _terms(cooling_ratio="ratio"),
        {"ratio": 1.0},
    ),
    ConcealedEffect("ambient_drift", ANY, _draw_ambient, _apply_ambient, {"rate": 0.0}),
    # Convection (n about 1.25 to 2) and linearised-away radiation (n up to 4): an extra power law.
    ConcealedEffect(
        "nonlinear_heat_loss", ANY, _draw_loss, _terms(loss_beta="beta", loss_power="power"), {"beta": 0.0}
    ),
    # Berglund and Guggenheim, Phys. Rev. 185, 1022, 1969: 4.3 kJ/mol, some 70 K of VO2's own heat capacity; the
    # film is a fifth of the cantilever or less.
    ConcealedEffect(
        "latent_heat",
        INTEGRATED,
        lambda c: {"heat": (log_uniform(c.rng, 0.4, 9.0), "K")},
        _terms(latent="heat"),
        {"heat": 0.0},
    ),
    # R_h(1 + alpha dT); 3.4e-3 1/K for bulk gold, less for thin films.
    ConcealedEffect(
        "heater_tcr",
        INTEGRATED,
        lambda c: {"temperature_coefficient": (log_uniform(c.rng, 4e-5, 1.5e-3), "1/K")},
        _terms(heater_tcr="temperature_coefficient"),
        {"temperature_coefficient": 0.0},
    ),
    ConcealedEffect("laser_heating", ANY, _draw_laser, _apply_laser, {"rise": 0.0}),
    ConcealedEffect(
        "sense_self_heating",
        INTEGRATED,
        _draw_sense,
        _terms(sense_heating="rise_per_ohm"),
        {"rise_per_ohm": 0.0},
    ),
    # Conductance and emissivity change with phase: loss g (1 + gamma s).
    ConcealedEffect(
        "phase_dependent_heat_loss",
        INTEGRATED,
        lambda c: {"gamma": (log_uniform(c.rng, 0.003, 0.1), "1")},
        _terms(loss_phase="gamma"),
        {"gamma": 0.0},
    ),
    ConcealedEffect(
        "peltier_joule_heating",
        PELTIER,
        _draw_peltier,
        _terms(joule="joule", pumping="pumping"),
        {"joule": 0.0, "pumping": 0.0},
    ),
    # Spread of heat into a deep substrate, half-order in time: Carslaw and Jaeger, Conduction of Heat in Solids, 2.7.
    ConcealedEffect(
        "substrate_diffusion",
        ANY,
        lambda c: {
            "gain": (log_uniform(c.rng, 0.006, 0.08), "1"),
            "time_constant": (c.seconds((0.02, 0.5), (60, 400)), "s"),
        },
        _apply_diffusion,
        {"gain": 0.0},
    ),
)
