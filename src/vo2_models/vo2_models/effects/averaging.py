"""One sensor shows the mean over a window."""

from vo2_models.effects.record import SAMPLED, SENSED, Effect, State, constant_of

LINE = 1024
"""Length of the ring [samples]; a power of two."""
LAST = LINE - 1

EFFECT = Effect(
    id="averaging",
    stage="sensor",
    parameters=(constant_of("window", 0, "s", "length over which the sensor averages", 0, 1e9), SAMPLED),
    states=(State("line", "unit", "ring of the last values", size=LINE),),
    channels=SENSED,
    signal=True,
    between_samples=True,
    order=15,
    typical={"integrated": {"window": (2e-3, 10e-3)}, "peltier": {"window": (2.0, 10.0)}},
    equation="y(t) = (1 / w) int from t - w to t of y_true; sampled: mean of the last w / period values",
    excitation="steps or a chirp with another channel to compare",
    source="integrating converters, any text on instrumentation",
    statement=(
        "One channel is the mean over a window, as an integrating meter gives it: a step becomes a straight ramp that ends "
        "at once, and tones whose period fits the window vanish. A first-order lag has neither."
    ),
)


def settled(value):
    return value


def advance(memory, line, value, sample):
    memory[line + (sample & LAST)] = value


def sensor(memory, line, sample, period, window, sampled):
    """Mean of the straight lines between the samples, or of the samples; a window longer than the ring is as long as it."""
    length = min(window / period, LINE - 2.0)
    whole = int(length)
    part = length - whole
    total = 0.0
    if sampled > 0.5:
        for k in range(whole):
            total += memory[line + ((sample - k) & LAST)]
        total += part * memory[line + ((sample - whole) & LAST)]
        return total / length if length > 0.0 else memory[line + (sample & LAST)]
    for k in range(whole):
        total += 0.5 * (memory[line + ((sample - k) & LAST)] + memory[line + ((sample - k - 1) & LAST)])
    newer = memory[line + ((sample - whole) & LAST)]
    older = memory[line + ((sample - whole - 1) & LAST)]
    total += part * (newer + 0.5 * part * (older - newer))
    return total / length if length > 0.0 else newer
