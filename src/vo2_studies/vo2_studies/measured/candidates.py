"""What may be missing: effect records of the catalogue, and two laws outside of it that the literature suggests.

A candidate of the catalogue is its effect record, refitted with the loop. One from outside acts on the recording before
the same fit sees it: on the drive (a spread of heat paths) or on the deflection (creep in the logarithm of time).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from vo2_models.device import preset
from vo2_models.effects import effect
from vo2_models.identification.grid import GriddedRecording
from vo2_models.recording import TIP_DEFLECTION

from vo2_studies.measured.cases import DEVICE, SPAN_K, drive_share

__all__ = ["LAG", "PIEZO", "RATE_INDEPENDENT", "VO2", "Candidate", "Extra"]

Floats = NDArray[np.float64]
Grids = Sequence[GriddedRecording]
INSTANT = 1e-6
"""Time constant [s] of a model without one."""


@dataclass(frozen=True)
class Extra:
    """A parameter that no effect record has: fitted as it is, or as its logarithm."""

    name: str
    unit: str
    start: float
    lower: float
    upper: float
    scale: float
    logarithmic: bool = False


@dataclass(frozen=True)
class Candidate:
    """One hypothesis.

    Attributes
    ----------
    id : of the effect record, or a name of its own where the catalogue has none
    equation : what is added
    effects : effect records with starting values, in units of the lag's time constant where `timed` says so
    timed : parameters of the effects (`id.name`) whose start is a multiple of the lag's time constant
    lag : whether the drive's lag is free; without it the model is rate independent
    extra : parameters of `transform`
    transform : (recordings, values of the extra parameters, whether they start settled) -> recordings as the fit sees
        them
    """

    id: str
    equation: str
    effects: Mapping[str, Mapping[str, float | str]]
    timed: tuple[str, ...] = ()
    lag: bool = True
    extra: tuple[Extra, ...] = ()
    transform: Callable[[Grids, Floats, bool], list[GriddedRecording]] | None = None

    @property
    def in_catalogue(self) -> bool:
        """Whether it is an effect record (or nothing at all)."""
        return not self.extra

    def started(self, tau: float, multiple: float) -> dict[str, dict[str, float | str]]:
        """Effects at their start, times told in lags `tau` [s], longer by `multiple`."""
        found: dict[str, dict[str, float | str]] = {}
        for key, values in self.effects.items():
            found[key] = {
                name: float(value) * tau * multiple if f"{key.split(':')[0]}.{name}" in self.timed else value
                for name, value in values.items()
            }
        return found

    @property
    def free(self) -> list[str]:
        """Names of the free parameters beside the loop's, as `fitting.problem` has them."""
        names = ["thermal.time_constant"] if self.lag else []
        for key, values in self.effects.items():
            head = "effects." + key.replace(":", ".")
            names += [f"{head}.{name}" for name in values if name != "signal"]
        return names


def _of_record(
    key: str, values: Mapping[str, float | str], timed: tuple[str, ...] = (), *, lag: bool = True
) -> Candidate:
    record = effect(key.split(":")[0])
    if ":" in key:
        values = {**values, "signal": key.split(":")[1]}
    return Candidate(record.id, record.equation, {key: values}, tuple(f"{record.id}.{n}" for n in timed), lag)


RATE_INDEPENDENT = Candidate("rate_independent", "y = loop(drive), the same at every rate", {}, lag=False)
LAG = Candidate("one_lag", "y = loop(x); tau dx/dt = drive - x", {})

RUNGS = 10
"""Heat paths that stand for a spread; a number that changed with its width would make the fit's residual jump."""


def _spread_of_lags(grids: Grids, values: Floats, settled: bool) -> list[GriddedRecording]:
    """Drive as a body feels it whose heat leaves on paths of all time constants between two, evenly by a power law."""
    first, last, power = np.exp(values[0]), np.exp(values[1]), values[2]
    last = max(last, 1.001 * first)
    constants = np.geomspace(first, last, RUNGS)
    weights = (constants / last) ** power
    weights /= np.sum(weights)
    found = []
    for grid in grids:
        share = drive_share(grid.current)
        felt = np.zeros(share.size)
        for weight, constant in zip(weights, constants, strict=True):
            keep = np.exp(-grid.dt / constant)
            memory = [keep * share[0]] if settled else [0.0]
            felt += weight * lfilter([1.0 - keep], [1.0, -keep], share, zi=memory)[0]
        current = np.sqrt(np.maximum(felt, 0.0) * SPAN_K / preset(DEVICE).square_gain)
        found.append(replace(grid, current=current))
    return found


def _log_creep(grids: Grids, values: Floats, settled: bool) -> list[GriddedRecording]:
    """Recordings with A ln(1 + t / t0) taken off the deflection."""
    size, onset = values[0], np.exp(values[1])
    found = []
    for grid in grids:
        time = np.arange(grid.current.size) * grid.dt
        flat = grid.measured[TIP_DEFLECTION] - size * np.log1p(time / onset)
        found.append(replace(grid, measured={**grid.measured, TIP_DEFLECTION: flat}))
    return found


VO2 = (
    _of_record("second_thermal_mode", {"share": 0.2, "time_constant": 10.0}, ("time_constant",)),
    _of_record("slow_relaxation", {"amplitude": 0.02, "onset": 1.0}, ("onset",)),
    _of_record("transition_kinetics", {"time_constant": 0.5}, ("time_constant",)),
    _of_record("cooling_asymmetry", {"ratio": 0.1}),
    _of_record("nonlinear_heat_loss", {"share": 0.06}),
    _of_record("phase_dependent_heat_loss", {"gamma": 0.1}),
    _of_record("latent_heat", {"latent": 5.0}),
    Candidate(
        "spread_of_lags",
        "x = sum_k w_k x_k; tau_k dx_k/dt = drive - x_k; w_k ~ tau_k^p, tau_k evenly in ln tau",
        {},
        lag=False,
        extra=(
            Extra("shortest", "s", 0.3, 1e-6, 1e3, 0.02, logarithmic=True),
            Extra("longest", "s", 100.0, 1e-4, 1e5, 0.02, logarithmic=True),
            Extra("power", "1", -0.5, -3.0, 2.0, 0.02),
        ),
        transform=_spread_of_lags,
    ),
)
"""Hypotheses for a VO2 device whose resistance is judged after pulses; starting times in lags."""

PIEZO = (
    _of_record("creep", {"share": 0.02, "time_constant": 500.0}, ("time_constant",)),
    _of_record("second_thermal_mode", {"share": 0.02, "time_constant": 500.0}, ("time_constant",)),
    _of_record("ambient_drift", {"rate": 0.01}),
    _of_record(f"sensor_gain_drift:{TIP_DEFLECTION}", {"rate": 1e-4}),
    _of_record("training_drift", {"shift": 0.01}),
    _of_record("transition_kinetics", {"time_constant": 0.5}, ("time_constant",)),
    _of_record("cooling_asymmetry", {"ratio": 0.1}),
    Candidate(
        "logarithmic_creep",
        "D_measured = D + A ln(1 + t / t0), t since the recording began",
        {},
        extra=(
            Extra("size", "m", 1e-7, -1e-5, 1e-5, 1e-8),
            Extra("onset", "s", 50.0, 1e-3, 1e4, 0.05, logarithmic=True),
        ),
        transform=_log_creep,
    ),
)
"""Hypotheses for a piezo, which moves in the terms of a deflection over a drive; starting times in lags."""
