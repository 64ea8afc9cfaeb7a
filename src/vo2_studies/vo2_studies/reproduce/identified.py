"""Identification as a user would do it: a damped oscillation played to the device, a fit of its noisy recording."""

from __future__ import annotations

from functools import partial

import numpy as np
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.device.simulation import Simulation
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.parameters import Value
from vo2_models.recording import Recording
from vo2_models.self_sensing.characterisation import characterise

__all__ = ["damped_recording", "identify"]


def damped_recording(device: Simulation, seed: int, *, level: int, hold: int, dt: float) -> Recording:
    """Play a damped oscillation over the operating range, each level held for `hold` samples of `dt` [s]."""
    cold, hot = preset(device.device).operating_range
    levels = cold + (hot - cold) * damped_oscillation(np.linspace(0.0, 1.0, level + 1))
    return device.simulate(np.repeat(levels, hold), dt=dt, seed=seed)


def identify(
    device: Simulation, seed: int, *, plays: int | None = None, level: int | None = None
) -> tuple[DeviceModel, dict[str, Value]]:
    """Return the model fitted to the device's noisy recording, and all its parameters with self-sensing.

    `integrated`: level 30, 10 ms each, at 1 kHz, as section 7.1.3; `peltier`: level 8, 60 s each, at 1 Hz.

    Parameters
    ----------
    device, seed : what is recorded, and of its noise
    plays : of each law of the model and of the composite scheme; None for the library's own
    level : of the Preisach model; None for the library's own
    """
    if device.device == "integrated":
        recording, degree = damped_recording(device, seed, level=30, hold=10, dt=1e-3), 8
    else:
        recording, degree = damped_recording(device, seed, level=8, hold=60, dt=1.0), 9
    fit = partial(fit_device, plays=plays) if plays else fit_device
    model = fit([recording], device.device).model
    parameters = model.to_parameters()
    own = ({"composite_plays": plays} if plays else {}) | ({"level": level} if level else {})
    return model, parameters | characterise(recording, parameters, degree=degree, **own)
