"""The own designs of section 8.5: chosen on simulated devices that take no part in any comparison.

Information. Every law gets the composite self-sensing and the model identified from its device's own noisy recording.
"PID" and "H-infinity alone" are feedback only. "With feedforward" adds inverse compensation by the same identified
model; the feedback then follows what the feedforward expects, so that it corrects errors of the model and not the
crossing of the loop, which is planned.

Rule. Every law keeps Ms and Mt below the same limit at every plant identified on the design devices, and is the one of
least RMSE under current noise on the same simulated design devices, whose time constants are 20 % off what was
identified, in turns up and down: the uncertainty that the margins are held for. Of the feedforward's rates those are
allowed whose control effort stays below that of the PID.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from vo2_control.controller import LinearController, LinearLaw
from vo2_control.discretise import RobustLaw, robust_law
from vo2_control.feedforward import feedforward_from_model
from vo2_control.hinf import DesignRefused
from vo2_control.integral_design import central_plant, covering_weight, integral_design
from vo2_control.model_tuning import loop_slopes
from vo2_control.pid import PidGains, pid_law
from vo2_control.sampled_loop import ThermalLag, loop_margins
from vo2_control.tuning import tune_pid
from vo2_models.device import truth
from vo2_models.device.coefficients import Coefficient
from vo2_models.device.simulation import Simulation
from vo2_models.parameters import Value
from vo2_models.self_sensing import self_sensing
from vo2_models.self_sensing.scheme import SelfSensing

from vo2_studies.reproduce.identified import identify
from vo2_studies.reproduce.peltier import (
    LIMITS,
    PERIOD_S,
    Merit,
    experiment,
    merit,
    reference,
)
from vo2_studies.reproduce.pool import run_many

__all__ = [
    "BANDWIDTHS_RAD_S",
    "DESIGN_SEED",
    "EFFORTS",
    "MAX_SENSITIVITY",
    "TIME_CONSTANT_SPREAD",
    "Ahead",
    "Designs",
    "feedforward",
    "integral_laws",
    "own_designs",
]

Floats = NDArray[np.float64]

MAX_SENSITIVITY = 1.6
DESIGN_SEED = 900_000
"""Of the first device that designs are made on; the comparison's and the robustness study's seeds lie far below."""
DESIGN_DEVICES, TUNING_DEVICES = 8, 4
"""Devices that the uncertainty and the final choice come from; the first of them the PID's many trials are run on."""
TIME_CONSTANT_SPREAD = 0.2
RESPONSE_S = 0.5
RATES_K_PER_S = (0.35, 0.4, 0.45, 0.5, 0.55)
EFFORT_SHARE = 0.97
"""Of the PID's effort, that the design may use on the design devices: a reserve for the spread of other devices."""
BANDWIDTHS_RAD_S = (0.002, 0.005, 0.01, 0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4)
EFFORTS = (0.1,)
"""Grid of `integral_laws` [rad/s, um/A]: from far below the loop's reach to where no plant keeps its margins."""


@dataclass(frozen=True)
class Ahead:
    """Feedforward current [A] and what it expects [m], (n,) each."""

    current_a: Floats
    expected_m: Floats


@dataclass(frozen=True)
class Designs:
    """The laws, and how they came about.

    Attributes
    ----------
    pid, robust_alone : feedback only
    pid_ahead, robust : with feedforward
    rate_k_per_s : of the feedforward
    peaks : name of a law -> largest of Ms and Mt over the identified plants
    notes : for the reader
    """

    pid: LinearLaw
    robust_alone: LinearLaw
    pid_ahead: LinearLaw
    robust: LinearLaw
    rate_k_per_s: float
    peaks: dict[str, float]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Found:
    """What is known of one design device."""

    seed: int
    parameters: dict[str, Value]
    plants: tuple[ThermalLag, ...]


def feedforward(parameters: dict[str, Value], kind: str, rate_k_per_s: float) -> Ahead:
    """Inverse compensation of an experiment's reference by an identified model."""
    law = feedforward_from_model(parameters, PERIOD_S, response_s=RESPONSE_S, rate_k_per_s=rate_k_per_s)
    return Ahead(*law.run(reference(kind)[0]))


def _identified(seed: int) -> _Found:
    model, parameters = identify(truth("peltier", seed=seed), seed)
    slopes = loop_slopes(model.simulation)
    tau, dead = model.scalars["thermal.time_constant"], model.scalars["driver.dead_time"]
    plants = tuple(
        ThermalLag(gain, tau * (1 + spread), dead)
        for gain in (0.5 * slopes.typical, slopes.largest)
        for spread in (-TIME_CONSTANT_SPREAD, TIME_CONSTANT_SPREAD)
    )
    return _Found(seed, parameters, plants)


def _bench(found: _Found) -> Simulation:
    """The design device as it is when the loop runs: its time constant has moved since the identification."""
    device = truth("peltier", seed=found.seed)
    coefficients = device.coefficients.copy()
    coefficients[Coefficient.TIME_CONSTANT] *= 1 + TIME_CONSTANT_SPREAD * (-1) ** found.seed
    return replace(device, coefficients=coefficients)


def _merit(device: Simulation, scheme: SelfSensing, law: LinearLaw, seed: int, ahead: Ahead | None) -> Merit:
    result = experiment(
        "noise",
        device,
        scheme,
        LinearController(law, LIMITS),
        seed,
        feedforward_a=ahead.current_a if ahead else None,
        expected_m=ahead.expected_m if ahead else None,
    )
    return merit("noise", result)


def _trial(job: tuple[_Found, LinearLaw, tuple[LinearLaw, ...]]) -> tuple[float, Floats, Floats]:
    """One device: PID's effort; RMSE of each law alone (laws,); RMSE and effort with feedforward (rates, laws, 2)."""
    found, pid, laws = job
    device, scheme = _bench(found), self_sensing("composite", found.parameters)
    alone = [_merit(device, scheme, law, found.seed, None).rmse_um for law in laws]
    table = np.empty((len(RATES_K_PER_S), len(laws), 2))
    for i, rate in enumerate(RATES_K_PER_S):
        ahead = feedforward(found.parameters, "noise", rate)
        for j, law in enumerate(laws):
            value = _merit(device, scheme, law, found.seed, ahead)
            table[i, j] = value.rmse_um, value.effort_ma
    return _merit(device, scheme, pid, found.seed, None).effort_ma, np.array(alone), table


def _tuned_pid(job: tuple[tuple[ThermalLag, ...], tuple[_Found, ...], float | None]) -> PidGains:
    """The PID of least cost within the margins, alone or with the feedforward of a rate."""
    plants, found, rate = job
    gains = sorted(abs(plant.gain) for plant in plants)
    sign = np.sign(plants[0].gain)
    times = [plant.time_constant_s for plant in plants]
    tau = 0.5 * (min(times) + max(times))
    steepest = ThermalLag(sign * gains[-1], tau, max(plant.dead_time_s for plant in plants))
    bench = [(_bench(f), self_sensing("composite", f.parameters)) for f in found]
    ahead = [feedforward(f.parameters, "noise", rate) if rate is not None else None for f in found]

    def cost(trial: PidGains) -> float:
        law = pid_law(trial, PERIOD_S)
        errors = [
            _merit(device, scheme, law, f.seed, a).rmse_um
            for (device, scheme), f, a in zip(bench, found, ahead, strict=True)
        ]
        return float(np.mean(errors))

    return tune_pid(
        steepest, PERIOD_S, derivative=True, max_sensitivity=MAX_SENSITIVITY, slopes=(sign * gains[0],),
        time_constant_spread=max(times) / tau - 1, cost=cost,
    ).gains  # fmt: skip


def _peak(law: LinearLaw, plants: tuple[ThermalLag, ...]) -> float:
    margins = [loop_margins(law, plant.sampled(PERIOD_S)) for plant in plants]
    return max(max(m.sensitivity_peak, m.complementary_peak) for m in margins)


def integral_laws(
    nominal: ThermalLag,
    plants: Sequence[ThermalLag],
    sample_period_s: float,
    *,
    max_sensitivity: float = 1.6,
    expected_sign: int = 0,
) -> list[RobustLaw]:
    """Return every law of the grid whose loop keeps Ms and Mt below the limit at every plant, slowest first.

    Parameters
    ----------
    nominal : plant of the synthesis, for instance `central_plant(plants)`
    plants : identified ones, which the uncertainty must cover and the sampled loop must hold
    max_sensitivity : limit of Ms and Mt; `worst` of each law are the margins where they are worst
    sample_period_s : [s]
    expected_sign : sign of the plant's gain

    Raises
    ------
    DesignRefused : no design keeps the limits; says how many were tried and why the last one failed.
    """
    uncertainty = covering_weight(nominal, plants)
    found = []
    reason = "none was tried"
    grid = list(itertools.product(BANDWIDTHS_RAD_S, EFFORTS))
    for bandwidth, effort in grid:
        design = integral_design(nominal, uncertainty, bandwidth_rad_s=bandwidth, effort=effort)
        try:
            # gamma has no meaning of its own here: the margins of the sampled loop decide
            robust = robust_law(design, sample_period_s, largest_gamma=math.inf, expected_sign=expected_sign)
        except DesignRefused as refused:
            reason = str(refused)
            continue
        margins = [loop_margins(robust.law, plant.sampled(sample_period_s), points=400) for plant in plants]
        worst = max(margins, key=lambda m: max(m.sensitivity_peak, m.complementary_peak))
        peak = max(worst.sensitivity_peak, worst.complementary_peak)
        if not worst.stable or peak > max_sensitivity:
            reason = f"sensitivity peak {peak:.2f} at an identified plant, need at most {max_sensitivity:g}"
            continue
        found.append(replace(robust, worst=worst))
    if not found:
        raise DesignRefused(f"weights: none of {len(grid)} designs keeps the limits; the last: {reason}")
    return found


def own_designs(workers: int, progress: Callable[[str, float], None]) -> Designs:
    """Return the designs; the second call in a process costs nothing. About a minute of two cores."""
    progress("designs on devices of their own, about a minute", 0.0)
    return _designs(workers)


@cache
def _designs(workers: int) -> Designs:
    seeds = [DESIGN_SEED + k for k in range(DESIGN_DEVICES)]
    found = run_many(_identified, seeds, workers, lambda n: None)
    plants = tuple(itertools.chain.from_iterable(f.plants for f in found))
    tuning = tuple(found[:TUNING_DEVICES])
    pid = _tuned_pid((plants, tuning, None))
    first = pid_law(pid, PERIOD_S)
    candidates = integral_laws(
        central_plant(plants), plants, PERIOD_S, max_sensitivity=MAX_SENSITIVITY, expected_sign=-1
    )
    laws = tuple(candidate.law for candidate in candidates)
    trials = run_many(_trial, [(f, first, laws) for f in found], workers, lambda n: None)
    efforts, alone, tables = (np.array(part) for part in zip(*trials, strict=True))
    share = (tables[..., 1] / efforts[:, None, None]).mean(axis=0)
    # where none stays below, the least effort: the page then says by how much it is missed
    allowed = share <= max(EFFORT_SHARE, float(share.min()))
    rmse = np.where(allowed, tables[..., 0].mean(axis=0), np.inf)
    i, j = np.unravel_index(np.argmin(rmse), rmse.shape)
    rate = RATES_K_PER_S[i]
    quiet = int(np.argmin(alone.mean(axis=0)))
    second = _tuned_pid((plants, tuning, rate))
    ahead = pid_law(second, PERIOD_S)
    chosen = {
        "PID": first,
        "PID + feedforward": ahead,
        "H-infinity alone": laws[quiet],
        "H-infinity": laws[j],
    }
    notes = (
        f"Designed on {DESIGN_DEVICES} devices (seeds from {DESIGN_SEED}), {len(plants)} identified plants with slopes from "
        f"{1e6 * min(abs(p.gain) for p in plants):.0f} to {1e6 * max(abs(p.gain) for p in plants):.0f} um/A and "
        f"+-{100 * TIME_CONSTANT_SPREAD:.0f} % on each time constant.",
        _pid_words("PID alone", pid),
        _pid_words("PID with feedforward", second),
        _robust_words("H-infinity alone", candidates[quiet]),
        _robust_words("H-infinity with feedforward", candidates[j]),
        f"Feedforward: the temperature is led at {rate:g} K/s at most (of {RATES_K_PER_S}): the rate of least RMSE whose effort "
        f"stays below {EFFORT_SHARE:g} of that of the PID on the design devices ({share[i, j]:.3f}).",
    )
    peaks = {name: _peak(law, plants) for name, law in chosen.items()}
    return Designs(first, laws[quiet], ahead, laws[j], rate, peaks, notes)


def _pid_words(name: str, gains: PidGains) -> str:
    return f"{name}: Kp {1e-6 * gains.kp:.3g} A/um, Ki {1e-6 * gains.ki:.3g} A/(um s), Kd {1e-6 * gains.kd:.3g} A s/um."


def _robust_words(name: str, robust: RobustLaw) -> str:
    design = robust.synthesis.design
    bandwidth = 0.5 * design.performance.zero_rad_s
    return (
        f"{name}: bandwidth asked {bandwidth:g} rad/s, effort weight {design.effort.gain:g} um/A, order {robust.taken.order} of "
        f"{robust.synthesis.controller.nstates}, structured singular value of robust stability "
        f"{robust.synthesis.robust_stability:.2f} for a multiplicative uncertainty of "
        f"{100 * design.multiplicative.gain:.0f} %."
    )
