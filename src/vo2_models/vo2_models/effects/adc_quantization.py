"""One converter is coarse."""

import numpy as np
from numpy.typing import NDArray

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


def value_step(values: NDArray[np.float64]) -> float:
    """Return the distance of neighbouring values if they lie on a comb, else 0.

    A comb is told from chance by values that repeat and lie, all of them, at multiples of one distance; single values
    beside it, as outliers are, may be a fiftieth of all.

    Parameters
    ----------
    values : (n,) finite
    """
    distinct, counts = np.unique(values, return_counts=True)
    if distinct.size > 0.8 * values.size:
        return 0.0
    repeated = distinct[counts > 1]
    return _step(distinct) or (_step(repeated) if np.sum(counts[counts > 1]) > 0.98 * values.size else 0.0)


def _step(distinct: NDArray[np.float64]) -> float:
    """Distance of neighbours of which all others are multiples, of values (m,) in order; 0 for none."""
    if distinct.size < 3:
        return 0.0
    gaps = np.diff(distinct)
    gaps = gaps[gaps > 1e-6 * np.max(gaps)]
    step = float(np.median(gaps[gaps < 1.5 * np.min(gaps)]))
    place = distinct / step
    return step if float(np.max(np.abs(place - np.rint(place)))) < 0.05 else 0.0


def evident(values):
    """The comb on which all values lie."""
    step = value_step(values)
    return ({"step": step}, np.zeros(values.shape, dtype=bool)) if step else None


def converter(value, step):
    return np.rint(value / step) * step
