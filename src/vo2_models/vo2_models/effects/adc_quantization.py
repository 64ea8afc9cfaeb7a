"""One converter is coarse."""

import numpy as np

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

EFFECT = Effect(
    id="adc_quantization",
    stage="sensor",
    parameters=(constant_of("step", 0, "channel unit", "distance of neighbouring values", 0, 1e12),),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    typical={
        "integrated:film_resistance": {"step": (1500.0, 5000.0)},
        "integrated:tip_deflection": {"step": (0.8e-6, 3e-6)},
        "peltier:film_resistance": {"step": (600.0, 2500.0)},
        "peltier:tip_deflection": {"step": (1e-6, 4e-6)},
        "peltier:stage_temperature": {"step": (0.3, 1.0)},
    },
    order=10,
    equation="y = step round(y_true / step)",
    excitation="slow ramps; the histogram shows a comb",
    source="any text on data acquisition",
    statement=(
        "One channel knows only a few values: its converter has too few bits for the range it is set to. The "
        "histogram is a comb and slow ramps become stairs."
    ),
)


def converter(value, step):
    return np.rint(value / step) * step
