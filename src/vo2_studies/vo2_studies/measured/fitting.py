"""Joint refit of the loop, the lag and a candidate to some recordings, and what it predicts of others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from vo2_models.device.model import DeviceModel, SensorModel
from vo2_models.identification.bank_fit import BankShape, fit_bank, shape_rules, starting_shape
from vo2_models.identification.bank_fit import evaluate as evaluate_bank
from vo2_models.identification.grid import GriddedRecording
from vo2_models.identification.levenberg_marquardt import LeastSquares, levenberg_marquardt
from vo2_models.identification.loops_fit import COLD, film_path
from vo2_models.identification.noise import correlation_inflation
from vo2_models.identification.problem import Problem
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

from vo2_studies.measured.candidates import INSTANT, LAG, Candidate
from vo2_studies.measured.cases import DEVICE, Case

__all__ = ["CandidateFit", "Setting", "fit_candidate", "fit_lag"]

Floats = NDArray[np.float64]
DEGREE = {RESISTANCE: 1, TIP_DEFLECTION: 2}
"""Of the polynomial beside the plays; a higher one swings between the recordings it was fitted to."""


@dataclass(frozen=True)
class Setting:
    """What is common to all fits of a set.

    Attributes
    ----------
    channel : judged one
    settled : whether recordings begin settled at their first drive, else from a long rest without drive
    plays : of the loop
    level : error that counts as one [judged unit]; only its ratio to the prior matters
    constants : time constants [s] at which the lag's fit is started
    steps : most iterations of a refit
    """

    channel: str
    settled: bool
    plays: int
    level: float
    constants: tuple[float, ...]
    steps: int = 60


@dataclass(frozen=True)
class CandidateFit:
    """A candidate fitted to some recordings.

    Attributes
    ----------
    candidate : what was fitted
    model : loop, lag and effects
    extra : values of the candidate's extra parameters, logarithms where it says so
    values, std : fitted parameters beside the loop's, with standard deviations (of logarithms: relative)
    at_bound : those that ended at a physical bound
    rms : of the residual on the recordings it was fitted to [judged unit]
    steps : iterations of the joint refit
    """

    candidate: Candidate
    model: DeviceModel
    extra: Floats
    values: dict[str, float]
    std: dict[str, float]
    at_bound: tuple[str, ...]
    rms: float
    steps: int
    setting: Setting = field(repr=False)

    def predict(self, case: Case) -> Floats:
        """Return what the fit says of a recording: (n,) in judged units (-log10 R, or m)."""
        grid = case.grid
        seen, offset = grid, np.zeros(grid.current.size)
        if self.candidate.transform is not None:
            seen = _seen([grid], self.candidate, self.extra, self.setting)[0]
            # what was taken off the measured values belongs to the prediction
            offset = np.nan_to_num(grid.measured[case.channel] - seen.measured[case.channel])
        chain = self.model.simulation
        state = chain.settled_state(seen.current[0], seen.dt) if self.setting.settled else None
        out = chain.run(seen.current, dt=seen.dt, state=state)
        return np.asarray(_judged_values(out, case.channel) + offset)

    def gap(self, case: Case) -> Floats:
        """Measured minus predicted (n,), NaN where not judged; of a resistance in log10 R."""
        gap = case.grid.measured[case.channel] - self.predict(case)
        return -gap if case.channel == RESISTANCE else gap


def fit_lag(setting: Setting, cases: Sequence[Case]) -> CandidateFit:
    """Fit loop and one lag, from the best of the setting's time constants."""
    starts = [(_loop(setting, cases, LAG, {}, constant)) for constant in setting.constants]
    best = min(range(len(starts)), key=lambda k: starts[k][1])
    return _refit(setting, cases, LAG, starts[best][0])


def fit_candidate(
    setting: Setting, cases: Sequence[Case], candidate: Candidate, tau: float, lag: CandidateFit | None = None
) -> CandidateFit:
    """Fit loop, lag and candidate together, from starts about a lag's time constant `tau` [s].

    Parameters
    ----------
    setting, cases : of the set; the judged samples of the cases count alike
    candidate : hypothesis
    tau : what `fit_lag` found
    lag : its fit, a second start for a candidate that is no physical effect but has a lag: the better fit is kept
    """
    if not candidate.effects:
        extra = _started(candidate, tau)
        constant = tau if candidate.lag else INSTANT
        starts = [_loop(setting, cases, candidate, {}, constant, extra)[0]]
        if lag is not None and candidate.lag:
            starts.append(lag.model)
        fits = [_refit(setting, cases, candidate, start, extra) for start in starts]
        return min(fits, key=lambda fit: fit.rms)
    tried = []
    for multiple in (1.0, 4.0) if candidate.timed else (1.0,):
        effects = candidate.started(tau, multiple)
        tried.append(_loop(setting, cases, candidate, effects, tau))
    best = min(tried, key=lambda pair: pair[1])[0]
    return _refit(setting, cases, candidate, best)


def _values(setting: Setting, grids: Sequence[GriddedRecording]) -> Floats:
    """Measured values along the path of `film_path`."""
    return np.concatenate([np.concatenate([[np.nan], grid.measured[setting.channel]]) for grid in grids])


def _loop(
    setting: Setting,
    cases: Sequence[Case],
    candidate: Candidate,
    effects: dict[str, dict[str, float | str]],
    tau: float,
    extra: Floats | None = None,
) -> tuple[DeviceModel, float]:
    """Fit the loop alone over the film's path; return the model and the residual's root mean square."""
    plain = [case.grid for case in cases]
    grids = plain if extra is None else _seen(plain, candidate, extra, setting)
    model = DeviceModel(DEVICE, scalars={"thermal.time_constant": tau}, effects=effects)
    path = film_path(model, grids, setting.settled)
    values = _values(setting, grids)
    needed = _needed(path, np.isfinite(values))
    degree = DEGREE[setting.channel]
    start = starting_shape(path[needed], values[needed], plays=setting.plays, degree=degree)
    fit = fit_bank(path[needed], values[needed], start, iterations=60)
    bank = fit.shape.bank()
    model = replace(model, **{_section(setting): bank})  # type: ignore[arg-type]
    return model, float(np.sqrt(np.nanmean(fit.residual**2)))


def _section(setting: Setting) -> str:
    return "resistance" if setting.channel == RESISTANCE else "deflection"


def _problem(
    setting: Setting, grids: Sequence[GriddedRecording], candidate: Candidate, model: DeviceModel
) -> Problem:
    return Problem(
        model,
        grids,
        [_section(setting), *candidate.free],
        levels={setting.channel: setting.level},
        settled=setting.settled,
    )


def _refit(
    setting: Setting,
    cases: Sequence[Case],
    candidate: Candidate,
    model: DeviceModel,
    extra: Floats | None = None,
) -> CandidateFit:
    """Refit loop, lag and candidate together.

    The derivatives by the loop's parameters are exact for what acts before the loop and leave out what a candidate does
    to its output afterwards, which is small; the residual is exact. All others are differences.
    """
    plain = [case.grid for case in cases]
    outer = np.zeros(0) if extra is None else extra

    def seen(values: Floats) -> Sequence[GriddedRecording]:
        return _seen(plain, candidate, values, setting)

    first = _problem(setting, seen(outer), candidate, model)
    inner = first.start.size
    loop = sum("[" in c.name for c in first.coordinates)
    beyond = _bounds(candidate)
    inside = 1e-9  # exp(log(bound)) may lie a rounding outside of what the record allows
    lower = np.concatenate([[c.lower + inside for c in first.coordinates], beyond[0]])
    upper = np.concatenate([[c.upper - inside for c in first.coordinates], beyond[1]])
    rules = shape_rules(setting.plays, loop, _values(setting, plain))
    lower[:loop], upper[:loop] = rules.lower, rules.upper
    # plays that the recordings say nothing about stay where they began, as in the fit of the loop alone
    prior = np.concatenate([rules.prior / setting.level**2, np.zeros(lower.size - loop)])
    scales = np.array([*(c.scale for c in first.coordinates), *(e.scale for e in candidate.extra)])

    def at(theta: Floats) -> Problem:
        return replace(first, grids=seen(theta[inner:])) if outer.size else first

    def evaluate(theta: Floats) -> tuple[Floats, Callable[[], Floats]]:
        here, path = _run(at(theta), theta[:inner], setting)

        def jacobian() -> Floats:
            columns = np.empty((here.size, theta.size))
            columns[:, :loop] = _loop_columns(setting, theta[:loop], path, plain)
            for place in range(loop, theta.size):
                step = 0.1 * scales[place]
                moved = theta.copy()
                moved[place] += step if theta[place] + step <= upper[place] else -step
                there = _run(at(moved), moved[:inner], setting)[0]
                columns[:, place] = (there - here) / (moved[place] - theta[place])
            return columns

        return here, jacobian

    found = levenberg_marquardt(
        evaluate,
        np.concatenate([first.start, outer]),
        lower=lower,
        upper=upper,
        largest_step=np.concatenate([rules.largest, 100.0 * scales[loop:]]),
        prior=prior,
        steps=setting.steps,
        tolerance=1e-4,
    )
    return _assembled(setting, candidate, first, found, found.theta[inner:])


def _run(problem: Problem, theta: Floats, setting: Setting) -> tuple[Floats, Floats]:
    """Simulated minus measured at the judged samples (m,), in levels, and the film's path as of `film_path`."""
    simulation = problem.simulation(theta)
    gaps, path = [], []
    for grid in problem.grids:
        state = simulation.settled_state(grid.current[0], grid.dt) if setting.settled else None
        out = simulation.run(grid.current, dt=grid.dt, state=state)
        measured = grid.measured[setting.channel]
        values = _judged_values(out, setting.channel)
        good = np.isfinite(measured)
        gaps.append((values - measured)[good] / setting.level)
        path += [np.array([COLD]), out[:, 5]]
    return np.concatenate(gaps), np.concatenate(path)


def _judged_values(out: Floats, channel: str) -> Floats:
    """-log10 R, or the deflection [m], of a run's output (n, 9)."""
    return -np.log10(np.clip(out[:, 1], 1e-12, 1e30)) if channel == RESISTANCE else out[:, 2]


def _loop_columns(setting: Setting, theta: Floats, path: Floats, grids: Sequence[GriddedRecording]) -> Floats:
    """Derivatives of the judged samples by the loop's parameters (m, p), in levels."""
    judged = np.isfinite(_values(setting, grids))
    needed = _needed(path, judged)
    shape = BankShape.of(theta, setting.plays)
    return evaluate_bank(shape, path[needed])[1][judged[needed]] / setting.level


def _needed(path: Floats, judged: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples (n,) that judged ones depend on: between turning points nothing is remembered."""
    steps = np.diff(path)
    turns = np.concatenate([[True], steps[1:] * steps[:-1] <= 0.0, [True]])
    still = np.concatenate([[False], (steps[1:] == 0.0) & (steps[:-1] == 0.0), [False]])
    return judged | (turns & ~still)


def _seen(
    grids: Sequence[GriddedRecording], candidate: Candidate, extra: Floats, setting: Setting
) -> Sequence[GriddedRecording]:
    if candidate.transform is None:
        return grids
    return candidate.transform(grids, extra, setting.settled)


def _bounds(candidate: Candidate) -> tuple[Floats, Floats]:
    """Of the extra parameters, logarithms where they are fitted so."""
    lower = [np.log(e.lower) if e.logarithmic else e.lower for e in candidate.extra]
    upper = [np.log(e.upper) if e.logarithmic else e.upper for e in candidate.extra]
    return np.array(lower), np.array(upper)


def _started(candidate: Candidate, tau: float) -> Floats:
    """Starting values of the extra parameters, about a lag's time constant."""
    lower, upper = _bounds(candidate)
    start = [np.log(e.start * tau) if e.logarithmic else e.start for e in candidate.extra]
    return np.clip(np.array(start), lower, upper)


def _assembled(
    setting: Setting, candidate: Candidate, problem: Problem, found: LeastSquares, extra: Floats
) -> CandidateFit:
    """Values and standard deviations of what was fitted beside the loop."""
    inner = found.theta.size - extra.size
    model = problem.model_at(found.theta[:inner])
    counted = found.residual[found.residual != 0.0]
    variance = float(np.mean(counted**2)) * correlation_inflation(counted)
    normal = found.jacobian.T @ found.jacobian
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(size, size)
    scaled[np.diag_indices_from(scaled)] += 1e-9
    spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(scaled)), 0.0) * variance) / size
    values, std, bound = {}, {}, []
    for place, coordinate in enumerate(problem.coordinates):
        if "[" in coordinate.name:
            continue
        value = float(found.theta[place])
        name = coordinate.name.removeprefix("effects.")
        values[name] = float(np.exp(value)) if coordinate.logarithmic else value
        std[name] = float(spread[place]) * (values[name] if coordinate.logarithmic else 1.0)
        margin = 1e-3 * max(coordinate.upper - coordinate.lower, 1e-12)
        if np.isfinite(margin) and (value < coordinate.lower + margin or value > coordinate.upper - margin):
            bound.append(name)
    for place, parameter in enumerate(candidate.extra):
        value = float(extra[place])
        values[parameter.name] = float(np.exp(value)) if parameter.logarithmic else value
        std[parameter.name] = float(spread[inner + place]) * (
            values[parameter.name] if parameter.logarithmic else 1.0
        )
    rms = float(np.sqrt(np.mean(counted**2))) * setting.level
    factor = np.log(10.0) if setting.channel == RESISTANCE else 1.0
    model = replace(model, sensors={setting.channel: SensorModel(noise=factor * rms, residual=rms)})
    return CandidateFit(candidate, model, extra, values, std, tuple(bound), rms, found.steps, setting)
