"""The phase drifts on while the temperature is held."""

import math

from vo2_models.effects.record import FILM, Effect, State, constant_of

HOLD = 0.1
"""Pace |dT/dt| t0 / T_f up to which a film is held: the after-effect grows ten times faster than the motion forgets it."""

EFFECT = Effect(
    id="slow_relaxation",
    stage="transition",
    parameters=(
        constant_of(
            "amplitude", 0, "1", "drift of the fraction at half transition, per e-fold of time", -0.2, 0.2
        ),
        constant_of("onset", 1, "s", "time after which the drift begins", 1e-9, 1e9),
        constant_of("travel", 0.5, "K", "motion after which 63 % of the drift is forgotten", 0.02, 20),
    ),
    channels=FILM,
    typical={
        "integrated": {"amplitude": (5e-3, 0.02), "onset": (2e-3, 0.01)},
        "peltier": {"amplitude": (5e-3, 0.02), "onset": (1.0, 5.0)},
    },
    states=(
        State("anchor", "degC", "temperature of the step before"),
        State("way", "1", "+1 heated, -1 cooled, 0 not moved yet: the last motion that was no hold"),
        State("relaxed", "1", "after-effect, ln(1 + t / t0) at rest"),
    ),
    equation=(
        "s + 4 A s (1 - s) y; dy/dt = (d / t0) exp(-d y) - (y / T_f) |dT/dt|, d the way of the last motion: "
        "y = d ln(1 + t / t0) while T is held"
    ),
    excitation="holds inside and outside the loop",
    source=(
        "logarithmic after-effect of a distribution of barriers (Neel; Street and Woolley); resistance "
        "relaxations of VO2 devices, Galloni et al., PNAS 121, 2024"
    ),
    statement=(
        "While the temperature is held inside the loop, domains whose barrier is almost overcome still switch,"
        " ever more slowly: resistance and deflection drift together with the logarithm of time. Outside the "
        "loop nothing is left to switch and nothing drifts; creep would drift there too, in deflection alone."
    ),
)


def settled(film):
    return film, 0.0, 0.0


def advance(film, h, anchor, way, relaxed, onset, travel):
    """dy/dt = (d / t0) exp(-d y) - (y / T_f) |dT/dt|, exact but for the order: half of the forgetting, growth, other half.

    d is the way of the last motion, +1 or -1; one that would take ten times t0 to forget y is a hold and does not change it.
    """
    moved = film - anchor
    if abs(moved) * onset > HOLD * travel * h:
        way = 1.0 if moved > 0.0 else -1.0
    half = math.exp(-0.5 * abs(moved) / travel)
    kept = way * relaxed * half
    return film, way, way * (kept + math.log1p(h / onset * math.exp(-kept))) * half


def beside(half_way, relaxed, amplitude):
    return amplitude * half_way * relaxed
