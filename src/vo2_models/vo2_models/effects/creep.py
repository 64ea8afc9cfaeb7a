"""Part of the deflection arrives late."""

import math

from vo2_models.effects.record import Effect, State, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="creep",
    stage="structure",
    parameters=(
        constant_of("share", 0, "1", "part of the deflection that creeps", -0.5, 0.5),
        constant_of("time_constant", 1, "s", "time constant of the creep", 1e-9, 1e9),
        constant_of("gain", 0, "1", "change of the resting deflection that comes with it", -0.5, 0.5),
    ),
    channels=(TIP_DEFLECTION,),
    typical={
        "integrated": {"share": (0.03, 0.12), "time_constant": (0.05, 0.5)},
        "peltier": {"share": (0.03, 0.12), "time_constant": (60.0, 200.0)},
    },
    states=(State("crept", "m", "deflection that the creeping part has reached"),),
    order=40,
    equation="D_measured = (1 + gain - share) D + share x; tau dx/dt = D - x",
    excitation="steps held for several creep time constants",
    source="standard linear solid; section 5.1.2 looked for it and found none",
    statement=(
        "Glue, polymer or grain boundaries give way slowly under the bending moment: after a step the "
        "deflection runs on while resistance and temperature have long settled. With gain = 0 a part of the known "
        "deflection is late, with gain = share the late part comes on top of it."
    ),
)


def settled(deflection):
    return deflection


def advance(deflection, period, crept, time_constant):
    return crept - math.expm1(-period / time_constant) * (deflection - crept)


def structure(deflection, crept, share, gain):
    return deflection + (share * (crept - deflection) + gain * deflection)
