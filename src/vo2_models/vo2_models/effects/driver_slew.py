"""The current source is slow to change."""

from vo2_models.device.coefficients import HUGE
from vo2_models.effects.record import ALL, Effect, constant_of

EFFECT = Effect(
    id="driver_slew",
    stage="driver",
    parameters=(constant_of("rate", HUGE, "A/s", "fastest change of the current", 1e-9, HUGE),),
    channels=ALL,
    typical={"integrated": {"rate": (0.3, 2.0)}, "peltier": {"rate": (0.03, 1.0)}},
    between_samples=True,
    order=30,
    equation="|di/dt| <= rate",
    excitation="large steps; the logged current shows ramps",
    source="any text on drives",
    statement=(
        "The source approaches a new current at a limited rate: large steps become ramps whose length grows "
        "with the step, small steps pass unchanged."
    ),
)


def drive(current, previous, period, rate):
    return min(max(current, previous - rate * period), previous + rate * period)
