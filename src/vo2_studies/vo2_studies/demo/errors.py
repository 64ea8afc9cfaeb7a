"""Estimation and tracking errors as the contract defines them, from the recorded bag alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vo2_identification.bags import read_bag
from vo2_identification.bags.reading import KNOWN_CHANNELS
from vo2_models.recording import TIP_DEFLECTION, Recording

from vo2_studies.demo.stage import Phase

__all__ = [
    "LEAD_SHARE",
    "TRUE_DEFLECTION",
    "PhaseData",
    "estimation_error",
    "loop_recordings",
    "phase_data",
    "recording_part",
    "tracking_error",
]

TRUE_DEFLECTION = "true_tip_deflection"
LEAD_SHARE = 0.05
"""First part of a tracking experiment that does not count."""
_HALF_SAMPLE = 0.4


@dataclass(frozen=True)
class PhaseData:
    """The samples of one phase, on common stamps.

    Attributes
    ----------
    time_s : (n,) since the start of the phase [s]
    true_m : (n,) tip deflection before its sensor [m]
    estimate_m, bound_m : (n,) [m]
    reference_m : (n,) [m], NaN where there is none
    current_a : (n,) measured current [A]
    """

    time_s: NDArray[np.float64]
    true_m: NDArray[np.float64]
    estimate_m: NDArray[np.float64]
    bound_m: NDArray[np.float64]
    reference_m: NDArray[np.float64]
    current_a: NDArray[np.float64]


def loop_recordings(bag: Path, namespace: str) -> dict[str, Recording]:
    """Read all samples of one loop, with what only a simulated device tells."""
    return read_bag(bag, namespace=namespace, channels=(*KNOWN_CHANNELS, TRUE_DEFLECTION))[0]


def phase_data(recordings: Mapping[str, Recording], phase: Phase) -> PhaseData:
    """Cut one phase out of the recordings of a loop.

    Parameters
    ----------
    recordings : role -> recording, from `loop_recordings`
    phase : which stretch of it

    Raises
    ------
    ValueError : a topic or a sample is missing; the message says where.
    """
    missing = {"measurement", "estimate"} - set(recordings)
    if missing:
        raise ValueError(f"{phase.namespace}: found no {' and no '.join(sorted(missing))} in the bag")
    measurement = recordings["measurement"]
    period = measurement.sample_period_s
    # the first sample of a phase was measured before its first command
    since = np.arange(1.0, round((phase.end_s - phase.start_s) / period) + 1) * period
    wanted = since + phase.start_s

    def channel(role: str, name: str, *, required: bool) -> NDArray[np.float64]:
        recording = recordings.get(role)
        if recording is None or name not in recording:
            return np.full(wanted.size, np.nan)
        place = np.clip(
            np.searchsorted(recording.time_s, wanted - _HALF_SAMPLE * period), 0, len(recording) - 1
        )
        there = np.abs(recording.time_s[place] - wanted) < _HALF_SAMPLE * period
        if required and not np.all(there):
            at = wanted[np.flatnonzero(~there)[0]]
            raise ValueError(
                f"{phase.namespace}, {phase.name}: {role} lacks {np.sum(~there)} samples, the first at {at:.6f} s"
            )
        return np.where(there, recording[name][place], np.nan)

    return PhaseData(
        since,
        channel("measurement", TRUE_DEFLECTION, required=True),
        channel("estimate", TIP_DEFLECTION, required=True),
        channel("estimate", "tip_deflection_bound", required=False),
        channel("reference", TIP_DEFLECTION, required=False),
        channel("measurement", "heater_current", required=True),
    )


def estimation_error(data: PhaseData) -> float:
    """Return mean |estimate - true deflection| [m]; every sample must have an estimate."""
    if not np.all(np.isfinite(data.estimate_m)):
        raise ValueError(f"{np.sum(~np.isfinite(data.estimate_m))} samples have no estimate")
    return float(np.mean(np.abs(data.estimate_m - data.true_m)))


def tracking_error(data: PhaseData) -> float:
    """Return mean |reference - true deflection| [m] after the first 5 %, transients included."""
    start = int(np.ceil(LEAD_SHARE * data.time_s.size))
    error = np.abs(data.reference_m - data.true_m)[start:]
    if not np.all(np.isfinite(error)):
        raise ValueError(f"{np.sum(~np.isfinite(error))} samples have no reference")
    return float(np.mean(error))


def recording_part(recording: Recording, start_s: float, end_s: float) -> Recording:
    """Return the samples with start_s <= stamp <= end_s."""
    first, stop = np.searchsorted(recording.time_s, [start_s - 1e-9, end_s + 1e-9])
    return recording.slice(int(first), int(stop))
