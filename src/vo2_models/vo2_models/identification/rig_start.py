"""Recordings that begin at a state which their drive does not show: demagnetised, relaxed, or wherever the last one ended.

What a device with hysteresis does depends on where its drive has been. Once that has been at an end of its range all before
is forgotten (the wiping-out property); until then a model that begins at saturation may be anywhere off.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.identification.grid import GriddedRecording
from vo2_models.identification.loop_law import root_mean_square
from vo2_models.identification.play_dictionary import PlayDictionary, fit_dictionary

__all__ = ["known_from", "unknown_until", "with_known_starts"]

Floats = NDArray[np.float64]
_END = 0.05
"""Share of the drive's range within which an end of it counts as reached."""
_MOST_UNKNOWN = 0.5
"""Share of a recording beyond which nothing is left out: too little would be left."""
_FURTHER_OFF = 3.0
"""Times the error afterwards by which the model must be off until then for the state to count as unknown."""
_FEWEST = 50
"""Measured samples afterwards below which nothing is left out: a fit needs them all."""
_GRID = {"centres": 20, "widths": 10}
_DEGREE = 3


def known_from(drive: Floats) -> int:
    """Return the first sample at which a drive (n,) is at an end of its range: from there on what was before it is forgotten.

    Parameters
    ----------
    drive : (n,) in any unit

    Examples
    --------
    >>> known_from(np.array([0.0, 1.0, 0.0, -1.0, 0.5]))
    1
    """
    low, high = float(np.min(drive)), float(np.max(drive))
    near = _END * (high - low)
    return min(int(np.argmax(drive >= high - near)), int(np.argmax(drive <= low + near)))


def unknown_until(gap: Floats, response: Floats, drive: Floats) -> int:
    """Return how many samples begin at a state that the drive does not show, 0 where the model's own start is as near.

    A gain that has moved would hide such a beginning: what of the gap a zero, a gain and a part in step with the drive explain
    afterwards is taken out before the two are compared.

    Parameters
    ----------
    gap : (n,) measured minus simulated, NaN where not judged
    response : (n,) simulated from saturation
    drive : (n,) in any unit
    """
    known = known_from(drive)
    later = np.arange(gap.size) >= known
    judged = later & np.isfinite(gap)
    if not 0 < known < _MOST_UNKNOWN * gap.size or not np.isfinite(gap[~later]).any() or not judged.any():
        return 0
    columns = np.stack([np.ones(gap.size), response, drive / np.max(np.abs(drive))], axis=1)
    left = gap - columns @ np.linalg.lstsq(columns[judged], gap[judged], rcond=None)[0]
    return known if root_mean_square(left[~later]) > _FURTHER_OFF * root_mean_square(left[later]) else 0


def with_known_starts(
    grids: Sequence[GriddedRecording], path: Floats, values: Mapping[str, Floats]
) -> Sequence[GriddedRecording]:
    """Return the recordings without the responses of an unknown beginning, or as they are where a saturated one does.

    Parameters
    ----------
    grids : of a device without body
    path : (n,) loop coordinate through all of them, one sample of saturation before each
    values : role -> (n,) responses along the path, NaN where missing
    """
    first = [known_from(grid.current) for grid in grids]
    if not any(first) or any(
        k > _MOST_UNKNOWN * grid.current.size for k, grid in zip(first, grids, strict=True)
    ):
        return grids
    ends = np.cumsum([0, *(grid.current.size + 1 for grid in grids)])
    before = np.zeros(path.size, dtype=np.bool_)
    for (begin, _), known in zip(itertools.pairwise(ends), first, strict=True):
        before[begin : begin + 1 + known] = True
    if not any(_is_unknown(path, y, before) for y in values.values()):
        return grids
    return [
        replace(
            grid,
            measured={
                role: np.where(np.arange(y.size) < known, np.nan, y) for role, y in grid.measured.items()
            },
        )
        for grid, known in zip(grids, first, strict=True)
    ]


def _is_unknown(path: Floats, values: Floats, before: NDArray[np.bool_]) -> bool:
    """Whether plays that are fitted to the rest of a response, and begin at saturation, are far off until then."""
    if not np.isfinite(values[before]).any() or np.count_nonzero(np.isfinite(values[~before])) < _FEWEST:
        return False
    inside = path[
        path > path.min()
    ]  # the saturation before each recording is far from where the plays are needed
    dictionary = PlayDictionary.over(float(inside.min()), float(inside.max()), **_GRID)
    fit = fit_dictionary(dictionary, path, np.where(before, np.nan, values), degree=_DEGREE, signed=True)
    left = fit.residual(path, values)
    return root_mean_square(left[before]) > _FURTHER_OFF * root_mean_square(left[~before])
