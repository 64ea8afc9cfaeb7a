"""The experiments of section 8.4 on a simulated Peltier device: references, noise, calibration, figures of merit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from vo2_control.closed_loop import LoopResult, run_loop
from vo2_control.controller import CurrentLimits, LinearController
from vo2_models.device.description import preset
from vo2_models.device.simulation import Simulation
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION
from vo2_models.self_sensing.polynomial import PolynomialSelfSensing
from vo2_models.self_sensing.scheme import SelfSensing

__all__ = [
    "CONTRACT",
    "EXPERIMENTS",
    "LIMITS",
    "MERIT_WORDS",
    "PERIOD_S",
    "Calibration",
    "Conditions",
    "Merit",
    "calibrate",
    "current_noise",
    "experiment",
    "merit",
    "reference",
    "setpoint_errors",
]

Floats = NDArray[np.float64]

PERIOD_S = preset("peltier").sample_period
LIMITS = CurrentLimits(*preset("peltier").current_range)
EXPERIMENTS = ("steps", "multi", "noise")
"""8.4.1, 8.4.2, 8.4.3."""
SETTLE_S = 100.0
"""Each loop first regulates to where the experiment starts: steps one step below the first one."""
NOISE_A = 0.01
DEGREE = 9
"""Of the polynomial in section 8.2."""


@dataclass(frozen=True)
class Conditions:
    """What the text does not print, or prints so that it cannot be: the contract's values, to be varied in a study.

    Attributes
    ----------
    steps_m, step_start_m : setpoints of 15 s each, and where the loop regulates to before them [m]
    multi_scale : factor on the amplitudes 8, 7 and 5 um of the multi-sine
    noise_a, noise_band : half amplitude of the current noise [A]; its band as a share of Nyquist. The printed 8 Hz cannot
        be at 8 Hz sampling
    """

    steps_m: tuple[float, ...] = (20e-6, 35e-6, 50e-6)
    step_start_m: float = 5e-6
    multi_scale: float = 1.0
    noise_a: float = NOISE_A
    noise_band: float = 0.8


CONTRACT = Conditions()


def reference(kind: str, conditions: Conditions = CONTRACT) -> tuple[Floats, int]:
    """Return the reference (n,) [m] with its settling part in front, and the number of samples of that part."""
    if kind == "steps":
        wanted = np.repeat(conditions.steps_m, round(15 / PERIOD_S))
        start = conditions.step_start_m
    else:
        t = np.arange(round(1000 / PERIOD_S)) * PERIOD_S
        parts = ((8.0, 0.001), (7.0, 0.005), (5.0, 0.01))
        swing = sum(size * np.sin(2 * np.pi * hertz * t) for size, hertz in parts)
        wanted = 1e-6 * (35.0 + conditions.multi_scale * swing)
        start = float(wanted[0])
    settle = round(SETTLE_S / PERIOD_S)
    return np.concatenate([np.full(settle, start), wanted]), settle


def current_noise(count: int, seed: int, conditions: Conditions = CONTRACT) -> Floats:
    """Uniform white current noise, band-limited; a narrower band than the contract's keeps the standard deviation."""
    white = np.random.default_rng([seed, 843]).uniform(-conditions.noise_a, conditions.noise_a, count)
    limited = np.asarray(sosfiltfilt(butter(4, conditions.noise_band, output="sos"), white))
    if conditions.noise_band != CONTRACT.noise_band:
        limited *= white.std() / limited.std()
    return limited


@dataclass(frozen=True)
class Calibration:
    """What section 8.2 does before any control: the major loop, a polynomial through both branches.

    Attributes
    ----------
    current_a, resistance_ohm, deflection_m : (n,) quasi-static major loop, measured with noise
    sensing : polynomial of degree 9
    operating_a : current that holds the middle of the references, 35 um, mean of both branches [A]
    """

    current_a: Floats
    resistance_ohm: Floats
    deflection_m: Floats
    sensing: PolynomialSelfSensing
    operating_a: float


def calibrate(device: Simulation, seed: int, *, levels: int = 150) -> Calibration:
    """Sweep the operating range up and down, each level held for ten time constants.

    Raises
    ------
    ValueError : a resistance that is not positive, as a drift over the hours of the sweep may give.
    """
    nominal = preset(device.device)
    way = np.linspace(*nominal.operating_range, levels)
    current = np.concatenate([way, way[::-1]])
    sweep = device.simulate(current, dt=10 * nominal.time_constant, seed=seed)
    resistance, deflection = sweep[RESISTANCE], sweep[TIP_DEFLECTION]
    if not resistance.min() > 0:
        raise ValueError(f"calibration: found a resistance of {resistance.min():g} ohm, need above 0")
    halves = (slice(0, levels), slice(levels, 2 * levels))
    middle = [current[half][np.argmin(np.abs(deflection[half] - 35e-6))] for half in halves]
    sensing = PolynomialSelfSensing.fit(resistance, deflection, DEGREE)
    return Calibration(current, resistance, deflection, sensing, float(np.mean(middle)))


def experiment(
    kind: str,
    device: Simulation,
    sensing: SelfSensing | None,
    controller: LinearController,
    seed: int,
    *,
    feedforward_a: Floats | None = None,
    expected_m: Floats | None = None,
    conditions: Conditions = CONTRACT,
) -> LoopResult:
    """Run one experiment; the settling part is cut off.

    Parameters
    ----------
    feedforward_a : (n,) current that the feedback corrects [A], over the whole reference
    expected_m : (n,) what the feedback is given as its reference instead of the reference itself [m], see
        `vo2_control.feedforward.InverseFeedforward`; errors are still of the reference
    """
    wanted, settle = reference(kind, conditions)
    disturbance = current_noise(wanted.size, seed, conditions) if kind == "noise" else None
    result = run_loop(
        device,
        sensing,
        controller,
        wanted if expected_m is None else expected_m,
        disturbance_a=disturbance,
        feedforward_a=feedforward_a,
        seed=seed,
    )
    return replace(result, reference_m=wanted).after(settle)


@dataclass(frozen=True)
class Merit:
    """Figures of merit after the first 5 % of an experiment.

    Attributes
    ----------
    rmse_um, largest_um : of the true deflection
    steady_um : mean over the setpoints of |mean error over the last 3 s|; NaN for the multi-sine
    effort_ma : standard deviation of the controller's current
    sensing_um : root mean square of estimate minus truth
    felt_rmse_um, felt_steady_um : as `rmse_um` and `steady_um`, of reference minus self-sensed deflection
    whole_rmse_um : as `rmse_um`, from the first sample on
    """

    rmse_um: float
    largest_um: float
    steady_um: float
    effort_ma: float
    sensing_um: float
    felt_rmse_um: float = float("nan")
    felt_steady_um: float = float("nan")
    whole_rmse_um: float = float("nan")


MERIT_WORDS = (
    # field of `Merit`, name, words, unit, distance from the published value within which a claim is met
    ("rmse_um", "rmse", "RMSE", "um", 0.2),
    ("largest_um", "largest", "Largest error", "um", 0.3),
    ("steady_um", "steady", "Mean steady-state error", "um", 0.4),
    ("effort_ma", "effort", "Control effort, s.d. of the current", "mA", 0.2),
)


def setpoint_errors(error_um: Floats) -> Floats:
    """Return |mean error over the last 3 s| of each of the three setpoints (3,) [um], from the errors (n,) of a run of steps."""
    last = round(3 / PERIOD_S)
    return np.asarray(np.abs(error_um.reshape(3, -1)[:, -last:].mean(axis=1)))


def merit(kind: str, result: LoopResult) -> Merit:
    """Return the figures of merit of an experiment."""
    first = result.time_s.size // 20
    error = 1e6 * result.error_m
    felt = 1e6 * (result.reference_m - result.estimate_m)
    steady = felt_steady = np.nan
    if kind == "steps":
        steady, felt_steady = (float(setpoint_errors(e).mean()) for e in (error, felt))
    return Merit(
        _rms(error[first:]),
        float(np.abs(error[first:]).max()),
        steady,
        float(1e3 * result.current_a[first:].std()),
        _rms((error - felt)[first:]),
        _rms(felt[first:]),
        felt_steady,
        _rms(error),
    )


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
