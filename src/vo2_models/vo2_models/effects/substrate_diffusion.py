"""Heat spreads into the substrate: a body without a time constant of its own."""

import math

from vo2_models.effects.record import HEAT, Effect, State, constant_of

NODES = 14
"""Relaxations that stand for the continuum."""
STEP = 1.5
"""Distance of their time constants [e-folds]; 14 of them reach from 6e-5 to 17000 times the time constant."""

EFFECT = Effect(
    id="substrate_diffusion",
    stage="thermal",
    parameters=(
        constant_of(
            "share", 0, "1", "part of the steady temperature rise that is the substrate's", -0.5, 0.5
        ),
        constant_of("time_constant", 1, "s", "time in which heat crosses the heated length", 1e-9, 1e9),
    ),
    states=(State("spread", "K", "temperature rise of each relaxation", size=NODES),),
    channels=HEAT,
    needs=("body",),
    typical={
        "integrated": {"share": (0.03, 0.1), "time_constant": (0.01, 0.1)},
        "peltier": {"share": (0.03, 0.1), "time_constant": (30.0, 200.0)},
    },
    equation="T = T0 + (1 - share) theta_1 + share theta_2; theta_2 + tau^(1/2) d^(1/2) theta_2 / dt^(1/2) = theta_1",
    excitation="steps held for many times the time constant of the body: the approach goes with the root of the time",
    source="Carslaw and Jaeger, Conduction of Heat in Solids, 1959 (half-space); spectrum: Cole and Cole, J. Chem. Phys. 9, 1941",
    statement=(
        "Heat leaves the body into a substrate that has no temperature of its own: the longer it flows, the deeper it "
        "warms. After a step the temperature runs on with the root of the time, fast at first and for very long, which no "
        "single slow body does."
    ),
)


def settled(drive):
    return drive


def advance(memory, spread, rise, h, time_constant):
    for k in range(NODES):
        tau = time_constant * math.exp(STEP * (k - 0.5 * (NODES - 1)))
        memory[spread + k] -= math.expm1(-h / tau) * (rise - memory[spread + k])


def body(memory, spread, share):
    """1 / (1 + (s tau)^(1/2)) is a mixture of relaxations of density 1 / (2 pi cosh(x / 2)) over x = ln(tau' / tau)."""
    total = weights = 0.0
    for k in range(NODES):
        weight = 1.0 / math.cosh(0.5 * STEP * (k - 0.5 * (NODES - 1)))
        total += weight * memory[spread + k]
        weights += weight
    return -share, share * total / weights
