"""One sensor's zero drifts."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import STAGE_TEMPERATURE, TIP_DEFLECTION

EFFECT = Effect(
    id="sensor_zero_drift",
    stage="sensor",
    parameters=(
        constant_of("rate", 0, "channel unit/s", "change of the zero per time", -1e12, 1e12),
        constant_of("curvature", 0, "channel unit/s^2", "half its change of rate per time", -1e12, 1e12),
    ),
    channels=(TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    course="rate",
    typical={
        "integrated:tip_deflection": {"rate": (5e-8, 3e-7)},
        "peltier:tip_deflection": {"rate": (5e-10, 4e-9)},
        "peltier:stage_temperature": {"rate": (3e-4, 2e-3)},
    },
    linear=False,
    order=45,
    equation="y = y_true + rate t + curvature t^2",
    excitation="identical loops at the start and the end of the recording",
    source="any text on instrumentation",
    statement=(
        "The zero of one channel wanders, as an amplifier, a mounting or a light source does that warms up: its values move "
        "on by the same amount wherever they are, while the other channels repeat themselves."
    ),
)


def sensor(value, time, rate, curvature):
    return value + time * (rate + time * curvature)
