"""Whether a scheme finds the deflection of the model's own loops again: it cannot where one resistance has many of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from vo2_models.device.description import preset
from vo2_models.hysteresis.laws import law_from_parameters
from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

if TYPE_CHECKING:
    from vo2_models.self_sensing.scheme import SelfSensing

__all__ = ["doubt_of"]

_LEVELS = (0.0, 1.0, 0.0, 0.8, 0.2, 0.65, 0.35, 0.5)
"""Where the path turns, in shares of the temperatures in use."""
_PER_LEG = 100
_LARGEST_ERROR = 0.2
"""Root mean square error over the span of the deflection: where it is unique some 0.05 at most, that of a constant 0.3."""


def doubt_of(scheme: SelfSensing, parameters: Mapping[str, Value]) -> str:
    """Return what speaks against a scheme in one sentence, empty where nothing does.

    Both laws of the model run on one path of shrinking loops; the scheme gets the resistance, without noise, and its
    deflection is compared with the model's. A model that lacks a law, or whose device is not known, is not judged.

    Parameters
    ----------
    scheme : built from the parameters
    parameters : flat `model.*` parameters
    """
    try:
        laws = [law_from_parameters(f"model.{name}", parameters) for name in ("resistance", "deflection")]
        device = preset(str(parameters.get("model.device", "")))
    except ValueError:
        return ""
    if not all(law.present for law in laws):
        return ""
    low, high = sorted(device.steady_temperature(drive) for drive in device.operating_range)
    legs = np.arange(_PER_LEG * (len(_LEVELS) - 1) + 1) / _PER_LEG
    path = low + (high - low) * np.interp(legs, np.arange(len(_LEVELS)), _LEVELS)
    y, deflection = (law.run(path, law.settle(low)) for law in laws)
    found = scheme.estimate(10.0**-y)[0].deflection
    error = float(np.sqrt(np.mean((found - deflection) ** 2)) / max(np.ptp(deflection), 1e-300))
    if error < _LARGEST_ERROR:
        return ""
    names = device.names
    one, other = names.get(RESISTANCE, RESISTANCE), names.get(TIP_DEFLECTION, TIP_DEFLECTION)
    return (
        f"{other} cannot be estimated from {one}: on the model's own loops the {scheme.kind} scheme errs by "
        f"{100 * error:.0f} % r.m.s. of the span, as where the relation is not unique"
    )
