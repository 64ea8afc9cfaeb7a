"""What a device file leaves open, taken from the recordings: ranges, noise, sampling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.description import DeviceDescription
from vo2_models.device.description_file import Document
from vo2_models.diagnosis.noise import level_from_differences
from vo2_models.effects.adc_quantization import value_step
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, Recording

__all__ = ["completed", "noise_of_recordings", "significant"]

_QUIETEST, _FEWEST = 0.3, 100
"""Share of the places, those with the least motion, from which a noise is taken, and samples below which all of them count."""


def completed(device: DeviceDescription, recordings: Sequence[Recording]) -> DeviceDescription:
    """Return the description with range and noise of each response, and the sample period, where the file has none.

    Parameters
    ----------
    recordings : in roles
    device : as its file tells
    """
    changes: Document = {"responses": {}}
    for response in device.responses:
        values = [r[response.role] for r in recordings if response.role in r]
        finite = np.concatenate(values) if values else np.empty(0)
        finite = finite[np.isfinite(finite) & ((finite > 0.0) | (response.role != RESISTANCE))]
        entry: Document = {}
        if finite.size and np.ptp(finite) > 0.0:
            entry["range"] = [significant(float(finite.min())), significant(float(finite.max()))]
            entry["noise"] = significant(noise_of_recordings(recordings, response.role))
        changes["responses"][response.channel] = entry
    if device.temperature_channel:
        changes["temperature"] = {"noise": significant(noise_of_recordings(recordings, STAGE_TEMPERATURE))}
    period = float(np.median([recording.sample_period_s for recording in recordings]))
    changes["sampling"] = {"period": significant(period)}
    return device.completed(changes)


def noise_of_recordings(recordings: Sequence[Recording], role: str) -> float:
    """Return one standard deviation of what changes from sample to sample where a response moves least.

    It is the median third difference of four neighbours, which a parabola does not reach, where these move least: by
    x_0 + x_1 / 3 - x_2 / 3 - x_3, of which it is independent in white noise. Values on a comb are still by their converter:
    there, and of few samples, the median is that of all second differences.

    Relative for the film response, else in the channel's unit; 0 where there are too few samples to tell.

    Parameters
    ----------
    recordings : in roles
    role : of the response
    """
    levels = []
    for recording in recordings:
        if role not in recording:
            continue
        values = recording[role][np.isfinite(recording[role])]
        steps = value_step(values) > 0.0 or values.size < _FEWEST
        if role == RESISTANCE:
            values = np.log(values[values > 0.0])
        if values.size > 2:
            levels.append(level_from_differences(values) if steps else _level_at_rest(values))
    return float(np.median(levels)) if levels else 0.0


def _level_at_rest(x: NDArray[np.float64]) -> float:
    """Level of the white noise on a signal (n,), see `noise_of_recordings`."""
    third = np.abs(np.convolve(x, [1.0, -3.0, 3.0, -1.0], "valid"))
    motion = np.abs(np.convolve(x, [3.0, 1.0, -1.0, -3.0], "valid"))
    still = third[motion <= np.quantile(motion, _QUIETEST)]
    return float(np.median(still) / (0.674490 * np.sqrt(20.0)))


def significant(value: float, digits: int = 4) -> float:
    """Return a number as one would write it into a file.

    Parameters
    ----------
    value : any number
    digits : that are kept
    """
    return float(f"{value:.{digits}g}")
