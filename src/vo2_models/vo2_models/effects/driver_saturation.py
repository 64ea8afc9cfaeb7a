"""The current source cannot deliver the current asked for."""

from vo2_models.device.coefficients import HUGE
from vo2_models.effects.record import ALL, Effect, constant_of

EFFECT = Effect(
    id="driver_saturation",
    stage="driver",
    parameters=(constant_of("limit", HUGE, "A", "largest magnitude of the current", 0, HUGE),),
    channels=ALL,
    typical={"integrated": {"limit": (7.4e-3, 8.0e-3)}, "peltier": {"limit": (0.85, 1.0)}},
    order=10,
    equation="|i| <= limit",
    excitation="currents beyond the limit; the logged current tells it from a clipping converter",
    source="any text on drives",
    statement=(
        "The source runs out of voltage: above a limit the current stays flat whatever is commanded, and "
        "everything behind it stays with it."
    ),
)


def drive(current, limit):
    return min(max(current, -limit), limit)
