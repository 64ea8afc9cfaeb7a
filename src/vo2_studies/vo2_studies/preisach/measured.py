"""Readers of the measured recordings that come with the project's reference data.

The data themselves are not part of the package; `data_folder` finds them beside the checkout.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ReversalCurves",
    "data_folder",
    "read_piezo",
    "read_reversal_curves",
    "read_voltage_sweep",
]

Floats = NDArray[np.float64]


def data_folder() -> Path | None:
    """Return the folder of measured data: `$VO2_DATA`, or `../shared/data` of a checkout, or None."""
    named = os.environ.get("VO2_DATA")
    if named:
        return Path(named) if Path(named).is_dir() else None
    here = Path(__file__).resolve()
    for folder in (Path.cwd(), *Path.cwd().parents, *here.parents):
        candidate = folder.parent / "shared" / "data"
        if candidate.is_dir():
            return candidate
    return None


@dataclass(frozen=True, eq=False)
class ReversalCurves:
    """First-order reversal curves: from saturation down to a reversal field, and up from there.

    Attributes
    ----------
    field_t : one array per curve [T], the first value is the reversal field
    moment_am2 : one array per curve [A m^2], corrected for drift
    calibration_am2 : (curves,) moment measured at one and the same field before each curve, uncorrected
    saturation_t : field of the saturation before each curve [T]
    """

    field_t: tuple[Floats, ...]
    moment_am2: tuple[Floats, ...]
    calibration_am2: Floats
    saturation_t: float


def read_reversal_curves(path: str | os.PathLike[str]) -> ReversalCurves:
    """Read a MicroMag first-order reversal file with one calibration point before each curve.

    Each moment is multiplied by (mean calibration moment) / (calibration moment interpolated in the order of
    measurement), which removes the slow drift of the instrument's gain.

    Parameters
    ----------
    path : of the file

    Returns
    -------
    ReversalCurves : one array per curve, in SI units

    Raises
    ------
    ValueError : no calibration points and curves in turn, or a line that is not two numbers.
    """
    lines = Path(path).read_text(encoding="latin-1").splitlines()
    header = {
        key.strip(): value.strip() for key, _, value in (line.partition("=") for line in lines if "=" in line)
    }
    blocks: list[list[tuple[float, float]]] = [[]]
    for number, line in enumerate(lines, 1):
        if line[:1] in ("+", "-"):
            parts = line.split(",")
            try:
                blocks[-1].append((float(parts[0]), float(parts[1])))
            except (IndexError, ValueError) as error:
                raise ValueError(f"{path}, line {number}: found {line!r}, need 'field,moment'") from error
        elif blocks[-1]:
            blocks.append([])
    filled = [np.array(block) for block in blocks if block]
    points, curves = filled[0::2], filled[1::2]
    if not curves or len(points) != len(curves) or any(point.shape[0] != 1 for point in points):
        raise ValueError(
            f"{path}: found {len(points)} calibration blocks of {[len(p) for p in points[:3]]}... points and {len(curves)} "
            "curves, need one calibration point before each curve"
        )
    calibration = np.array([point[0, 1] for point in points])
    position = np.cumsum([0, *(len(curve) + 1 for curve in curves[:-1])])
    moments = []
    for start, curve in zip(position, curves, strict=True):
        drift = np.interp(start + 1.0 + np.arange(len(curve)), position, calibration)
        moments.append(curve[:, 1] * np.mean(calibration) / drift)
    return ReversalCurves(
        tuple(np.ascontiguousarray(curve[:, 0]) for curve in curves),
        tuple(moments),
        calibration,
        float(header["HSat"]) if "HSat" in header else float(points[0][0, 0]),
    )


def read_piezo(path: str | os.PathLike[str]) -> tuple[Floats, Floats]:
    """Return actuator voltage [V] and displacement [m] (n,) of the piezo recording, sampled at 200 Hz.

    Parameters
    ----------
    path : of the file
    """
    table = np.loadtxt(path, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] < 5:
        raise ValueError(f"{path}: found shape {table.shape}, need at least 5 columns")
    return np.ascontiguousarray(table[:, 0]), table[:, 4] * 1e-6


def read_voltage_sweep(path: str | os.PathLike[str]) -> tuple[Floats, Floats, Floats]:
    """Return voltage [V], current [A] and resistance [ohm] (n,) of the two-terminal VO2 sweep.

    Parameters
    ----------
    path : of the file
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        rows = list(csv.reader(file))
    values = []
    for row in rows:
        try:
            values.append([float(cell) for cell in row[:5]])
        except ValueError:
            continue  # the settings and the column titles above the numbers
    table = np.array([row for row in values if len(row) == 5])
    if table.size == 0:
        raise ValueError(
            f"{path}: found no line of five numbers, need index, time, voltage, current, resistance"
        )
    return table[:, 2].copy(), table[:, 3].copy(), table[:, 4].copy()
