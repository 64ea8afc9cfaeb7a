"""One converter clips."""

from vo2_models.device.coefficients import HUGE
from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

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


def converter(value, low, high):
    return min(max(value, low), high)
