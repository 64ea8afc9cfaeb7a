"""What a recording could not determine, and where a fit does not represent its own calibration: sentences for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from vo2_models.device.description import DeviceDescription
from vo2_models.identification.grid import GriddedRecording

__all__ = ["Coverage", "coverage_of", "misfit_note"]

Floats = NDArray[np.float64]
_TURN = 0.05
"""Way back, as a share of the drive's span, from which a turn counts."""
_ALIKE = 0.1
"""Relative spread below which amplitudes, or rates, count as one."""
_POOR_NOISE, _POOR_SHARE = 5.0, 0.01
_BLOCKS = 20


@dataclass(frozen=True)
class Coverage:
    """What recordings left undetermined.

    Attributes
    ----------
    one_rate : whether all swings have one rate, so that a lag and a wider loop are the same
    notes : one sentence each
    """

    one_rate: bool
    notes: tuple[str, ...]


def coverage_of(grids: Sequence[GriddedRecording], device: DeviceDescription) -> Coverage:
    """Return what the recordings could not determine: other amplitudes, other rates, a branch.

    Parameters
    ----------
    grids : recordings in roles
    device : completed description
    """
    span = float(np.ptp(np.concatenate([grid.current for grid in grids])))
    sizes, rates, ways = [], [], set()
    for grid in grids:
        turns = _turns(grid.current, _TURN * span)
        steps = np.diff(grid.current[turns])
        ways |= set(np.sign(steps).astype(int).tolist())
        sizes += np.abs(steps).tolist()
        rates += (np.abs(steps) / (np.diff(turns) * grid.dt)).tolist()
    name, unit, notes = device.drive_channel, device.drive_unit, []
    if not {-1, 1} <= ways:
        return Coverage(True, (f"{name} only goes one way: the other branch is a guess; record both",))
    if len(sizes) > 4:
        # the way in and the way out of a recording are no full swings
        sizes, rates = sizes[1:-1], rates[1:-1]
    if max(sizes) - min(sizes) < _ALIKE * max(sizes):
        notes.append(
            f"every swing of {name} has the same size, {np.median(sizes):.3g} {unit}: what smaller loops look like inside "
            "it is a guess; record some"
        )
    one_rate = max(rates) < (1.0 + _ALIKE) ** 2 * min(rates)
    if one_rate:
        notes.append(
            f"{name} has one rate, about {np.median(rates):.3g} {unit}/s: a lag cannot be told from a wider loop and "
            "counts as one; record another rate"
        )
    return Coverage(one_rate, tuple(notes))


def misfit_note(
    grids: Sequence[GriddedRecording],
    device: DeviceDescription,
    channel: str,
    unit: str,
    residual: Floats,
    values: Floats,
    noise: float,
) -> str:
    """Return where the fit leaves most of a response, or nothing where noise explains what is left.

    Parameters
    ----------
    residual, values : (n,) along all recordings, one sample before each
    noise : one standard deviation, in the unit of the residual
    grids : recordings in roles
    device : completed description
    channel : of the response
    """
    span = float(np.nanmax(values) - np.nanmin(values))
    left = float(np.sqrt(np.nanmean(residual**2)))
    if left < max(_POOR_NOISE * noise, _POOR_SHARE * span):
        return ""
    drive = np.concatenate([np.concatenate([[np.nan], grid.current]) for grid in grids])
    time = np.concatenate([grid.start + grid.dt * np.arange(-1, grid.current.size) for grid in grids])
    good = np.flatnonzero(np.isfinite(residual))
    blocks = np.array_split(good, _BLOCKS)
    worst = max((block for block in blocks if block.size), key=lambda block: np.sum(residual[block] ** 2))
    share = np.sum(residual[worst] ** 2) / np.nansum(residual**2)
    return (
        f"{channel}: the fit does not represent its own calibration: {left:.3g} {unit} r.m.s. are left, "
        f"{100 * left / span:.2g} % of the span, at a noise of {noise:.2g}; {100 * share:.0f} % of the energy lies between "
        f"{time[worst[0]]:.4g} and {time[worst[-1]]:.4g} s, {device.drive_channel} {np.nanmin(drive[worst]):.3g} to "
        f"{np.nanmax(drive[worst]):.3g} {device.drive_unit}"
    )


def _turns(drive: Floats, least: float) -> NDArray[np.intp]:
    """Indices of the first sample, of every turn by more than `least`, and of the last sample."""
    peaks = find_peaks(drive, prominence=least)[0]
    valleys = find_peaks(-drive, prominence=least)[0]
    inner = np.sort(np.concatenate([peaks, valleys]))
    return np.concatenate([[0], inner, [drive.size - 1]])
