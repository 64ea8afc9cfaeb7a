"""A current that is read back beside the command: what its reading shows, and how far it can be trusted.

A reading tells at once what the driver makes of a command, which resistance and deflection only show through heat. It has
an offset and a gain of its own, and whether it is the mean over a sample or the value at its end is not written in
a recording.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.noise import fit_noise
from vo2_models.diagnosis.nominal import drive_of
from vo2_models.recording import HEATER_CURRENT, Recording

__all__ = ["as_commanded", "between_samples", "current_reading"]

Floats = NDArray[np.float64]
FOLLOWS = (0.5, 2.0)
"""Gains between which a reading is one of the heater's current: of a loose wire it is near nothing."""
FEWEST = 100
"""Readings from which a line through them is fitted."""
STILL = 3.0
"""Change from sample to sample, in noise levels, up to which the current is taken as held."""


def current_reading(recording: Recording) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return offset [A] and gain of a calibration's current reading, and its noise (innovation [A], AR terms).

    reading = offset + gain command + noise, by least squares. Both are empty where that says nothing of the current: where
    the log only repeats the command, was read fewer than `FEWEST` times, or does not follow the command.

    Parameters
    ----------
    recording : with `heater_current` [A] and, where the bag has commands, `commanded_current` [A], (n,) each

    Raises
    ------
    ValueError : a log without a finite value.
    """
    if HEATER_CURRENT not in recording:
        return (), ()
    command, own = drive_of(recording)
    logged = recording[HEATER_CURRENT]
    good = np.isfinite(logged)
    if not own or np.count_nonzero(good) < FEWEST:
        return (), ()
    columns = np.column_stack([np.ones(command.size), command])
    line = np.linalg.lstsq(columns[good], logged[good])[0]
    if not FOLLOWS[0] < line[1] < FOLLOWS[1]:
        return (), ()
    found = fit_noise(np.where(good, (logged - columns @ line) / line[1], 0.0), good)
    return tuple(line.tolist()), (found.innovation, *found.ar)


def as_commanded(reading: Floats, line: Sequence[float]) -> Floats:
    """Return the command (n,) [A] that a reading stands for.

    Parameters
    ----------
    reading : (n,) [A]
    line : its offset [A] and gain; empty where they are not known
    """
    return (reading - line[0]) / line[1] if line else reading


def between_samples(reading: Floats, noise: float) -> Floats:
    """Return half of what a reading moves within a sample, beyond its noise: mean and last value differ by as much.

    Parameters
    ----------
    reading : (n,) [A]
    noise : its standard deviation [A]
    """
    return 0.5 * np.maximum(np.abs(np.diff(reading, prepend=reading[:1])) - STILL * noise, 0.0)
