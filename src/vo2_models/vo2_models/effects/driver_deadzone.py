"""The current source ignores small commands."""

from vo2_models.device.coefficients import Coefficient
from vo2_models.effects.record import ALL, Effect, constant_of, setting

EFFECT = Effect(
    id="driver_deadzone",
    stage="driver",
    parameters=(constant_of("width", 0, "A", "half width of the dead zone", 0, 10),),
    apply=setting(width=Coefficient.DEADZONE),
    channels=ALL,
    typical={"integrated": {"width": (0.1e-3, 0.3e-3)}, "peltier": {"width": (0.02, 0.08)}},
    equation="i = sign(u) max(|u| - width, 0)",
    excitation="currents around zero and at several levels; the logged current shows it",
    source="any text on drives",
    statement=(
        "Around zero the source delivers nothing, and beyond it less than asked for by the width of the zone: "
        "a bias or a threshold of the output stage."
    ),
)
