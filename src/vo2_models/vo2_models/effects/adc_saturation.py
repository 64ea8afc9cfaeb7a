"""One converter clips."""

import numpy as np

from vo2_models.device.coefficients import HUGE
from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

REPEATED = 8
"""So often a converter at its limit gives the same value; noise does not."""
MORE = 4.0
"""So many times as often as any value within the limits."""
BEYOND = 0.02
"""Share of the values, outliers, that may lie beyond a limit."""
STILL = 0.1
"""Share of neighbouring values within the limits that are equal from which there is no noise, and rest repeats a value too."""

EFFECT = Effect(
    id="adc_saturation",
    stage="sensor",
    parameters=(
        constant_of("low", -HUGE, "channel unit", "lowest value the converter shows", -HUGE, HUGE),
        constant_of("high", HUGE, "channel unit", "highest value the converter shows", -HUGE, HUGE),
    ),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    typical={
        "integrated:film_resistance": {"high": (80e3, 180e3)},
        "integrated:tip_deflection": {"high": (42e-6, 54e-6)},
        "peltier:film_resistance": {"high": (30e3, 90e3)},
        "peltier:tip_deflection": {"high": (50e-6, 64e-6)},
        "peltier:stage_temperature": {"high": (68.0, 78.0)},
    },
    order=20,
    equation="y = min(max(y_true, low), high)",
    excitation="values beyond the limit; the histogram shows a wall",
    source="any text on data acquisition",
    statement=(
        "The range of one channel's converter is too small: beyond a limit the signal is flat although the "
        "others move on."
    ),
)


def evident(values):
    """The ends that the values reach again and again, exactly, as they do no value between."""
    distinct, counts = np.unique(values, return_counts=True)
    below = np.cumsum(counts) - counts
    ends = {}
    for name, beyond in (("low", below), ("high", values.size - below - counts)):
        inside = np.flatnonzero(beyond <= BEYOND * values.size)
        ends[name] = int(inside[np.argmax(counts[inside])])
    usual = np.max(np.delete(counts, list(ends.values())), initial=0)
    found = {
        name: float(distinct[end])
        for name, end in ends.items()
        if distinct.size > 2 and counts[end] >= max(REPEATED, MORE * usual)
    }
    flat = np.isin(values, list(found.values()))
    moving = ~(flat[1:] | flat[:-1])
    if not found or np.count_nonzero(moving & (values[1:] == values[:-1])) > STILL * np.count_nonzero(moving):
        return None
    return found, flat


def converter(value, low, high):
    return min(max(value, low), high)
