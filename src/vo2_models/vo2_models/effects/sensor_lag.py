"""One sensor answers with a lag."""

import math

from vo2_models.effects.record import SAMPLED, Effect, State, constant_of
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

EFFECT = Effect(
    id="sensor_lag",
    stage="sensor",
    parameters=(constant_of("time_constant", 0, "s", "time constant of the sensor", 0, 1e9), SAMPLED),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    typical={"integrated": {"time_constant": (0.7e-3, 4e-3)}, "peltier": {"time_constant": (0.7, 4.0)}},
    states=(
        State("lagged", "unit", "what the sensor shows"),
        State("last", "unit", "value of the sample before"),
    ),
    between_samples=True,
    order=10,
    equation="tau dy/dt = y_true - y; sampled: y_k = y_(k-1) + (1 - exp(-period / tau)) (y_true,k - y_(k-1))",
    excitation="steps or a chirp with another channel to compare",
    source="any text on instrumentation",
    statement=(
        "One channel passes through a low-pass filter: an averaging meter, a slow probe. Its edges are rounded"
        " and late while the other channels are as before."
    ),
)


def settled(value):
    return value, value


def advance(value, period, time_constant_between, lagged, last, time_constant, sampled):
    if sampled > 0.5:
        return value - math.exp(-period / time_constant) * (value - lagged), value
    # exact for an input that moves from sample to sample as the heat does under a held current
    heat, slow = max(period / time_constant_between, 1e-3), period / time_constant
    gap = slow - heat
    left = math.exp(-slow)
    meanwhile = math.exp(-heat) * slow * (-math.expm1(-gap) / gap if abs(gap) > 1e-6 else 1.0)
    old = (meanwhile - math.exp(-heat) * (1.0 - left)) / -math.expm1(-heat)
    return lagged * left + last * old + value * (1.0 - left - old), value


def sensor(lagged):
    return lagged
