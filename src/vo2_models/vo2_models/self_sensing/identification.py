"""From an identification recording to everything the estimator needs, in one call."""

from __future__ import annotations

from collections.abc import Callable

from vo2_models.identification.device_fit import fit_device
from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing.characterise import characterise

__all__ = ["identify"]


def identify(
    recording: Recording, device: str, *, progress: Callable[[str, float], None] | None = None
) -> dict[str, Value]:
    """Fit the simulation of a device and its self-sensing; return flat `model.*` parameters.

    Parameters
    ----------
    recording : current with resistance, deflection or both; where one is missing, so is what rests on it
    device : preset id
    progress : called with what is being done and the share done, 0 to 1

    Raises
    ------
    ValueError : a recording that cannot be fitted; the message says why.
    """
    parameters = fit_device([recording], device, progress=progress).model.to_parameters()
    if RESISTANCE in recording and TIP_DEFLECTION in recording:
        parameters |= characterise(recording, parameters)
    return parameters
