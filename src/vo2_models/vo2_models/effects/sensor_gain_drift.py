"""One sensor's gain drifts."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

EFFECT = Effect(
    id="sensor_gain_drift",
    stage="sensor",
    parameters=(
        constant_of("rate", 0, "1/s", "relative change of the gain per time", -1e6, 1e6),
        constant_of("curvature", 0, "1/s^2", "half its change of rate per time", -1e12, 1e12),
    ),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    course="rate",
    typical={"integrated": {"rate": (1e-3, 5e-3)}, "peltier": {"rate": (1e-5, 6e-5)}},
    order=40,
    equation="y = y_true (1 + rate t + curvature t^2)",
    excitation="identical loops at the start and the end of the recording",
    source="any text on instrumentation",
    statement=(
        "The amplifier of one channel warms up: its values grow or shrink in proportion, more the longer the "
        "recording lasts, while the other channels repeat themselves."
    ),
)


def sensor(value, time, rate, curvature):
    return value * (1.0 + time * (rate + time * curvature))
