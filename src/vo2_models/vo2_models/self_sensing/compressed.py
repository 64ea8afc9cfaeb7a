"""Error bounds of self-sensing with a model whose laws were compressed: the old ones and what the compression changes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vo2_models.device.model import DeviceModel
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE
from vo2_models.self_sensing.bounds import fit_bound
from vo2_models.self_sensing.records import BOUND_KNOTS, SECTION
from vo2_models.self_sensing.scheme import self_sensing

__all__ = ["bounds_after"]

LEVEL, HOLD = 30, 10
"""Of the damped oscillation that both are compared on, as section 7.1.3 identifies with; samples of each level."""


def bounds_after(before: Mapping[str, Value], after: Mapping[str, Value]) -> dict[str, Value]:
    """Return the parameters of the error bounds of a compressed model.

    On the resistance that the model as it was shows along a damped oscillation over its operating range, both estimate the
    deflection. What 95 % of the passes by a resistance differ by there is added to the bound that was measured: no error is
    larger than the old one and the difference together.

    Parameters
    ----------
    before, after : flat parameters of the model and of its compression

    Returns
    -------
    bounds of every scheme that had one; empty without any

    Raises
    ------
    ValueError : a compression that is no self-sensing model any more.
    """
    prefix = f"{SECTION}.bounds."
    kinds = [name.removeprefix(prefix) for name in before if name.startswith(prefix) and name != BOUND_KNOTS]
    knots = np.atleast_1d(np.asarray(before.get(BOUND_KNOTS, []), dtype=np.float64))
    if not kinds or knots.size == 0:
        return {}
    model = DeviceModel.from_parameters(before)
    cold, hot = model.description.operating_range
    levels = cold + (hot - cold) * damped_oscillation(np.linspace(0.0, 1.0, LEVEL + 1))
    resistance = model.simulation.simulate(np.repeat(levels, HOLD), noise=False)[RESISTANCE]
    found: dict[str, Value] = {BOUND_KNOTS: knots.tolist()}
    for kind in kinds:
        old, new = (
            self_sensing(kind, values, judged=False).estimate(resistance)[0].deflection
            for values in (before, after)
        )
        change = fit_bound(np.log10(resistance), np.asarray(new) - np.asarray(old), knots)
        found[f"{prefix}{kind}"] = (np.asarray(before[f"{prefix}{kind}"]) + change).tolist()
    return found
