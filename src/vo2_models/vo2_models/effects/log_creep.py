"""Part of the deflection arrives with the logarithm of the time."""

import math

from vo2_models.effects.record import Effect, State, constant_of
from vo2_models.recording import TIP_DEFLECTION

NODES = 9
"""Relaxations that stand for the logarithm: it holds over six decades of time."""
STEP = 1.75
"""Distance of their time constants [e-folds]."""

EFFECT = Effect(
    id="log_creep",
    stage="structure",
    parameters=(
        constant_of("rate", 0, "1", "part of the deflection that creeps in an e-fold of time", -0.05, 0.05),
        constant_of("onset", 1, "s", "time after which the creep goes with the logarithm", 1e-9, 1e9),
        constant_of("gain", 0, "1", "change of the deflection at rest that comes with it", -0.8, 0.8),
    ),
    states=(State("crept", "m", "deflection that each relaxation has reached", size=NODES),),
    channels=(TIP_DEFLECTION,),
    order=45,
    typical={
        "integrated": {"rate": (3e-3, 0.012), "onset": (2e-3, 0.02)},
        "peltier": {"rate": (3e-3, 0.012), "onset": (5.0, 40.0)},
    },
    equation="D_measured = (1 + gain) D - rate times what is left to come, which falls by one in each e-fold after a step",
    excitation="steps held for times of very different lengths",
    source="piezo creep, e.g. Vieira, IEEE Trans. Instrum. Meas. 35, 1986; relaxation by a wide spectrum of barriers",
    statement=(
        "The structure gives way by steps that need more and more time: after a change the deflection runs on by the same "
        "amount in each decade of time, without ever coming to rest, while resistance and temperature have long settled. With "
        "gain = 0 a part of the known deflection is late, with gain = 15.75 rate the late part comes on top of it."
    ),
)


def settled(deflection):
    return deflection


def advance(memory, crept, deflection, period, onset):
    for k in range(NODES):
        tau = onset * math.exp(STEP * k)
        memory[crept + k] -= math.expm1(-period / tau) * (deflection - memory[crept + k])


def structure(memory, crept, deflection, rate, gain):
    late = 0.0
    for k in range(NODES):
        late += memory[crept + k] - deflection
    return deflection + (rate * STEP * late + gain * deflection)
