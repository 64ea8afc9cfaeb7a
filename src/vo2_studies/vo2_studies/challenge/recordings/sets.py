"""The measured sets: a calibration, other recordings of the same device, and how far repeats lie apart.

Sources and licences stand in the data folder's README. A device file tells only what its laboratory knows for certain:
channels, units, limits of the drive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import Recording

__all__ = ["MeasuredSet", "load_sets", "repeat_spread"]

Array = NDArray[np.floating]
MOST = 1200
"""Most samples of a recording: of a longer one every second, third ... is taken, so that a case takes minutes."""
BINS = 60
"""Bins of the drive, for each direction, in which repeats are compared, where there are samples for them."""
PER_BIN = 8
"""Samples of a recording for each bin."""


@dataclass(frozen=True)
class MeasuredSet:
    """One device.

    Attributes
    ----------
    name : id of the device
    document : its device file
    drive, response, unit : channels, and the unit of the response
    calibration : recording that the model is fitted to
    others : what it is ("half", "sparse", "rerun", "remounted", "itself") -> another recording of the same device
    spread : r.m.s. distance of repeats, in the unit of the response (decades for ohm)
    """

    name: str
    document: Mapping[str, Any]
    drive: str
    response: str
    unit: str
    calibration: Recording
    others: Mapping[str, Recording]
    spread: float


def judged(values: Array, unit: str) -> Array:
    """Return a response as it is judged: resistance in log10 ohm."""
    return np.log10(values) if unit == "ohm" else values


def repeat_spread(first: Recording, second: Recording, drive: str, response: str, unit: str) -> float:
    """Return the r.m.s. distance of two recordings of the same path, branch by branch along the drive.

    A recording compared with itself has none: then it is the noise, from the second differences.
    """
    if first is second:
        bends = np.diff(judged(first[response], unit), 2)
        return float(1.4826 * np.median(np.abs(bends)) / np.sqrt(6))
    bins = min(BINS, min(len(first), len(second)) // PER_BIN)
    edges = np.linspace(float(first[drive].min()), float(first[drive].max()), bins + 1)
    found = []
    for recording in (first, second):
        place = np.clip(np.searchsorted(edges, recording[drive]) - 1, 0, bins - 1)
        place = 2 * place + (np.gradient(recording[drive]) > 0)
        count = np.bincount(place, minlength=2 * bins)
        total = np.bincount(place, judged(recording[response], unit), minlength=2 * bins)
        found.append(np.where(count > 2, total / np.maximum(count, 1), np.nan))
    return float(np.sqrt(np.nanmean((found[0] - found[1]) ** 2)))


def _measured(
    name: str, drive: tuple[str, str], response: tuple[str, str], calibration: Recording, **others: Recording
) -> MeasuredSet:
    """Put a set together, with recordings of at most `MOST` samples; drive and response are (channel, unit)."""
    calibration = _thinned(calibration)
    others = {what: _thinned(recording) for what, recording in others.items()}
    drives = np.concatenate([r[drive[0]] for r in (calibration, *others.values())])
    low, high = float(drives.min()), float(drives.max())
    room = 0.05 * (high - low)
    document = {
        "schema": "vo2-device/1",
        "id": name,
        "drive": {
            "channel": drive[0],
            "unit": drive[1],
            "limits": [low - room, high + room],
            "operating": [low, high],
        },
        "body": {"kind": "none"},
        "responses": {response[0]: {"unit": response[1]}},
        "sampling": {"period": float(f"{calibration.sample_period_s:.3g}")},
    }
    repeat = next(iter(others.values()))
    spread = repeat_spread(calibration, repeat, drive[0], response[0], response[1])
    return MeasuredSet(name, document, drive[0], response[0], response[1], calibration, others, spread)


def _piezo(folder: Path) -> MeasuredSet:
    table = np.loadtxt(folder / "piezo" / "Model_Vi_Do.dat")
    time = np.arange(len(table)) / 200.0
    channels = {"drive_voltage": table[:, 0], "tip_deflection": table[:, 4] * 1e-6}
    whole = Recording(time, channels, "piezo")
    half = len(whole) // 2
    return _measured(
        "piezo",
        ("drive_voltage", "V"),
        ("tip_deflection", "m"),
        whole.slice(0, half),
        half=whole.slice(half, len(whole)),
    )


def _seal(folder: Path, bar: int) -> MeasuredSet:
    name = f"seal_{bar}_bar"

    def read(run: str) -> Recording:
        table = np.loadtxt(folder / "seal_friction" / f"{run}_O-ring257_{bar}bar.csv.gz")
        time = table[:, 0] * 1e-3
        later = np.concatenate([[True], np.diff(time) > 0])
        channels = {"piston_position": table[later, 4] * 1e-3, "pull_force": table[later, 6]}
        return Recording(time[later], channels, name)

    return _measured(
        name,
        ("piston_position", "m"),
        ("pull_force", "N"),
        read("rerun/1"),
        rerun=read("rerun/2"),
        remounted=read("reconnected/1"),
    )


def _film(folder: Path) -> MeasuredSet:
    table = np.loadtxt(
        folder / "vo2_device" / "VO2_data_RvsV_transition.csv", delimiter=",", skiprows=35, usecols=(1, 2, 4)
    )
    channels = {"drive_voltage": table[:, 1], "film_resistance": table[:, 2]}
    whole = Recording(table[:, 0], channels, "vo2_film")
    even, odd, sparse = (_every(whole, first, step) for first, step in ((0, 2), (1, 2), (1, 8)))
    return _measured(
        "vo2_film",
        ("drive_voltage", "V"),
        ("film_resistance", "ohm"),
        even,
        half=odd,
        itself=even,
        sparse=sparse,
    )


def _thinned(recording: Recording) -> Recording:
    return _every(recording, 0, -(-len(recording) // MOST))


def _every(recording: Recording, first: int, step: int) -> Recording:
    """Return every `step`-th sample from `first` on: what a slower logger would have written."""
    channels = {name: values[first::step] for name, values in recording.channels.items()}
    return Recording(recording.time_s[first::step], channels, recording.device)


def _magnet(folder: Path) -> MeasuredSet:
    """First-order reversal curves, every second one for the calibration; no stamps: the elapsed time in equal parts."""
    text = (folder / "magnetic_forc" / "UB199BF").read_text(encoding="latin-1")
    curves: list[NDArray[np.float64]] = []
    before: list[list[str]] = []
    for block in text.split("\n\n"):
        pairs = [line.split(",") for line in block.split("\n") if line[:1] in "+-" and line.count(",") == 1]
        if len(pairs) > 1:
            curves.append(np.array([*before, *pairs]).astype(np.float64))
            before = []
        else:  # the drift calibration before a curve; it also tells where the field came from
            before = pairs
    parts = []
    for first in (0, 1):
        table = np.concatenate(curves[first::2])
        channels = {"applied_field": table[:, 0], "magnetic_moment": table[:, 1]}
        parts.append(Recording(np.arange(len(table), dtype=float), channels, "magnet"))
    return _measured("magnet", ("applied_field", "T"), ("magnetic_moment", "A m2"), parts[0], half=parts[1])


_SETS: dict[str, Callable[[Path], MeasuredSet]] = {
    "piezo": _piezo,
    **{f"seal_{bar}_bar": partial(_seal, bar=bar) for bar in (1, 3, 5, 7)},
    "vo2_film": _film,
    "magnet": _magnet,
}


def load_sets(folder: Path) -> list[MeasuredSet]:
    """Return all measured sets of a data folder.

    Raises
    ------
    ValueError : a file is missing or is not what its README says; with the file.
    """
    found = []
    for name, load in _SETS.items():
        try:
            found.append(load(folder))
        except (OSError, ValueError, IndexError) as error:
            raise ValueError(
                f"recordings: {folder}: {name}: {error}; need the data folder as it came"
            ) from error
    return found
