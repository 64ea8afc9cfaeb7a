"""One channel's samples are older than their stamp."""

import math

from vo2_models.effects.record import SAMPLED, Effect, State, constant_of
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

LINE = 256
"""Length of the ring [samples]; a power of two."""
LAST = LINE - 1

EFFECT = Effect(
    id="clock_offset",
    stage="sensor",
    parameters=(constant_of("delay", 0, "s", "age of the channel's value at its stamp", 0, 1e9), SAMPLED),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    typical={"integrated": {"delay": (0.5e-3, 3e-3)}, "peltier": {"delay": (0.4, 3.0)}},
    states=(State("line", "unit", "ring of the last values", size=LINE),),
    between_samples=True,
    order=20,
    equation="y(t) = y_true(t - delay); sampled: on the straight lines between the values",
    excitation="steps or a chirp with another channel to compare",
    source="any text on data acquisition",
    statement=(
        "One channel is stamped late: another clock, a buffer, a converter that is read in turn. The whole "
        "signal is shifted in time without being rounded."
    ),
)


def settled(value):
    return value


def advance(memory, line, value, sample):
    memory[line + (sample & LAST)] = value


def sensor(memory, line, sample, period, time_constant_between, delay, sampled):
    late = delay / period
    whole = int(late)
    part = late - whole
    # between samples the value goes the way of the heat under a held current
    heat = max(period / time_constant_between, 1e-3)
    share = math.exp(heat * (part - 1.0)) * math.expm1(-heat * part) / math.expm1(-heat)
    if sampled > 0.5:
        share = part
    newer = memory[line + ((sample - whole) & LAST)]
    older = memory[line + ((sample - whole - 1) & LAST)]
    return newer + share * (older - newer)
