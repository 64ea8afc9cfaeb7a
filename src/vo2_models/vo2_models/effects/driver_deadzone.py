"""The current source ignores small commands."""

import math

from vo2_models.effects.record import ALL, Effect, constant_of

EFFECT = Effect(
    id="driver_deadzone",
    stage="driver",
    parameters=(constant_of("width", 0, "A", "half width of the dead zone", 0, 1e12),),
    channels=ALL,
    typical={"integrated": {"width": (0.1e-3, 0.3e-3)}, "peltier": {"width": (0.02, 0.08)}},
    order=20,
    equation="i = sign(u) max(|u| - width, 0)",
    excitation="currents around zero and at several levels; the logged current shows it",
    source="any text on drives",
    statement=(
        "Around zero the source delivers nothing, and beyond it less than asked for by the width of the zone: "
        "a bias or a threshold of the output stage."
    ),
)


def drive(current, width):
    return math.copysign(max(abs(current) - width, 0.0), current)
