"""The four things that are done with a device: simulate it, fit it, estimate from its resistance, diagnose it.

A model is a mapping of flat `model.*` parameters throughout, as `load_model_parameters` reads them from a file. `diagnose`
itself is `vo2_models.diagnosis.diagnose`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from vo2_models.device.description import preset
from vo2_models.device.ground_truth import truth
from vo2_models.device.model import DeviceModel
from vo2_models.identification.model_fit import fit_model
from vo2_models.parameters import Value
from vo2_models.recording import Recording, as_recordings
from vo2_models.self_sensing.records import BOUND_KNOTS
from vo2_models.self_sensing.scheme import Estimate, self_sensing

__all__ = ["estimate", "fit", "simulate"]

BEYOND = 0.1
"""Share of the calibrated decades of resistance beyond which a resistance is another one than noise can make it."""


def simulate(
    device: str | Mapping[str, Value],
    current: ArrayLike,
    *,
    dt: float | None = None,
    seed: int = 0,
    noise: bool = True,
    effects: Mapping[str, Mapping[str, float | str]] | None = None,
) -> Recording:
    """Run a device on a current, from its long cold rest. What its drive cannot give is cut off, and told as a `UserWarning`.

    Parameters
    ----------
    device : preset, for the nominal device of thousands of switching domains; or a fitted model
    current : (n,) commanded current [A]; element k flows during the interval that ends at sample k
    dt : sample period [s], None for the preset's
    seed : of the measurement noise
    noise : whether the sensors add noise
    effects : physics beyond the nominal device, `{id: {parameter: value}}`

    Returns
    -------
    Recording : the device's channels in SI units, the command, and the true values under names that start with `true_`

    Raises
    ------
    ValueError : unknown preset or effect, a value out of its range, a current that is not finite.

    Examples
    --------
    >>> recording = simulate("integrated", [4e-3, 6e-3, 8e-3])
    >>> len(recording), "film_resistance" in recording
    (3, True)
    """
    _tell_what_is_cut(device, current)
    if isinstance(device, str):
        return truth(device).with_effects(effects or {}).simulate(current, dt=dt, seed=seed, noise=noise)
    model = DeviceModel.from_parameters(device)
    found = model.simulation.with_effects(effects or {}).simulate(current, dt=dt, seed=seed, noise=noise)
    return model.description.in_channels(found)


def fit(
    recordings: Recording | Sequence[Recording],
    device: str,
    *,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Value]:
    """Fit simulation and self-sensing of a device to calibration recordings.

    What the recordings did not allow is told as a `UserWarning`, one sentence each. `identification.model_fit.fit_model`
    returns residuals and uncertainties as well.

    Parameters
    ----------
    recordings : of one device, with the channels that it has; each from a cold rest or settled at its first current
    device : preset that the device is like, or the path of a device file
    progress : called with what is being done and the share done, 0 to 1

    Returns
    -------
    dict : flat `model.*` parameters, for `save_model_parameters`, `simulate`, `estimate` and `diagnose`

    Raises
    ------
    ValueError : recordings that cannot be fitted; the message says why.
    """
    given = [preset(device).understood(recording) for recording in as_recordings(recordings)]
    if not given:
        raise ValueError("recordings: found none, need at least one")
    result, parameters = fit_model(given, device, progress=progress)
    for note in result.notes:
        warnings.warn(note, UserWarning, stacklevel=2)
    return parameters


def estimate(model: Mapping[str, Value], resistance: ArrayLike, *, scheme: str = "composite") -> Estimate:
    """Estimate the deflection from the resistance, sample by sample from the cold.

    Resistances far from those of the calibration are told as a `UserWarning`: there neither estimate nor bound says anything.

    Parameters
    ----------
    model : from `fit`
    resistance : (n,) film resistance [ohm]
    scheme : one of `vo2_models.self_sensing.KINDS`

    Returns
    -------
    Estimate : arrays (n,): deflection and its error bound [m], temperature [degC], temperature surrogate [A]

    Raises
    ------
    ValueError : unknown scheme, a model without self-sensing, a resistance that is not above 0.
    """
    found = self_sensing(scheme, model).estimate(resistance)[0]
    knots = np.atleast_1d(np.asarray(model.get(BOUND_KNOTS, []), dtype=np.float64))
    if knots.size > 1:
        measured = np.log10(np.asarray(resistance, dtype=np.float64))
        beyond = BEYOND * float(np.ptp(knots))
        outside = (measured < knots[0] - beyond) | (measured > knots[-1] + beyond)
        if np.any(outside):
            warnings.warn(
                f"resistance: found {10 ** measured.min():.3g} to {10 ** measured.max():.3g} ohm, calibrated were "
                f"{10 ** knots[0]:.3g} to {10 ** knots[-1]:.3g} ohm: {100 * np.mean(outside):.3g} % of the samples lie far "
                "outside, where estimate and bound say nothing; check the unit",
                UserWarning,
                stacklevel=2,
            )
    return found


def _tell_what_is_cut(device: str | Mapping[str, Value], current: ArrayLike) -> None:
    """Say that a drive beyond its limits is cut off."""
    known = preset(device if isinstance(device, str) else str(device.get("model.device", "")))
    low, high = known.current_range
    asked = np.asarray(current, dtype=np.float64)
    if asked.size and (asked.min() < low or asked.max() > high):
        unit = known.drive_unit
        warnings.warn(
            f"current: found {asked.min():g} to {asked.max():g} {unit}, the drive gives {low:g} to {high:g} {unit}: cut off "
            "there; check the unit",
            UserWarning,
            stacklevel=3,
        )
