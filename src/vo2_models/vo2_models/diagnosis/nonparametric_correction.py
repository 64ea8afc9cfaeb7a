"""A correction without a name: smooth functions of what a mismatch may depend on, chosen on held-out blocks.

Used where nothing of the catalogue explains the excess. It says what the excess depends on, how much of it a
function of that removes on blocks it was not fitted on, and nothing about the cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, welch

from vo2_models.diagnosis.breakdown import turning_points
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nominal import Response
from vo2_models.diagnosis.part import Part
from vo2_models.diagnosis.problem import LinearisedProblem, Row
from vo2_models.identification.enrichment import cubic_spline
from vo2_models.recording import HEATER_CURRENT

__all__ = ["NonparametricCorrection", "Shape", "fit_nonparametric_correction"]

Floats = NDArray[np.float64]
CYCLES = 5
"""Fewest cycles within a recording that make a tone."""


@dataclass(frozen=True)
class Shape:
    """One group of functions that the correction of a channel uses.

    Attributes
    ----------
    channel : it corrects
    group : what it depends on
    words : the dependence in words
    share : of the channel's excess that it removes on held-out blocks, beyond the groups before it
    size : root mean square of its contribution, in noise levels
    """

    channel: str
    group: str
    words: str
    share: float
    size: float


@dataclass(frozen=True)
class NonparametricCorrection:
    """The correction without a name.

    Attributes
    ----------
    shapes : groups in use, most important first
    share : of the whole excess removed on held-out blocks
    prediction : (N,) whitened, each sample predicted from the other fold
    removed : energy that it removes on held-out blocks, in noise powers of a sample
    """

    shapes: tuple[Shape, ...]
    share: float
    prediction: Floats
    removed: float = 0.0


def fit_nonparametric_correction(
    problem: LinearisedProblem,
    residual: Floats,
    folds: list[NDArray[np.bool_]],
    limits: Limits,
    *,
    most: int = 4,
) -> NonparametricCorrection:
    """Choose groups of functions greedily for each channel, judged on held-out blocks.

    Parameters
    ----------
    problem : the problem
    residual : (N,) whitened, nuisance model taken out
    folds : held-out masks (N,), which partition the samples
    limits : when a channel has an excess, a group is worth it, and a line is a tone
    most : groups per channel

    Returns
    -------
    the groups, most important first, and what they predict of the rest
    """
    shapes: list[Shape] = []
    prediction = np.zeros(residual.size)
    before = after = 0.0
    for channel in dict.fromkeys(row.channel for row in problem.rows):
        own = [row for row in problem.rows if row.channel == channel]
        place = np.concatenate([np.arange(row.where.start, row.where.stop) for row in own])
        use = problem.weight[place] > 0
        target = residual[place]
        count = int(np.count_nonzero(use))
        energy = float(np.sum(target[use] ** 2))
        excess = energy - count
        if excess < limits.unnamed * count:
            before, after = before + energy - count, after + energy - count
            continue
        groups = {
            name: (words, problem.apply_inverse_covariance_in(problem.rows_of(channel), block))
            for name, (words, block) in _groups(problem, own, residual, limits).items()
        }
        chosen: list[tuple[str, str, float, float]] = []
        columns = np.zeros((place.size, 0))
        best_energy, best = energy, np.zeros(place.size)
        while len(chosen) < most:
            trials = {}
            for name, (words, block) in groups.items():
                if name in (c[0] for c in chosen):
                    continue
                candidate = np.column_stack([columns, block])
                guess = _cross_predicted(candidate, target, use, [fold[place] for fold in folds])
                trials[name] = (float(np.sum((target - guess)[use] ** 2)), guess, words, candidate)
            if not trials:
                break
            name = min(trials, key=lambda n: trials[n][0])
            found, guess, words, candidate = trials[name]
            if best_energy - found < max(limits.unnamed_share * excess, limits.unnamed_gain):
                break
            share = min((best_energy - found) / excess, 1.0)  # by chance it may leave less than noise
            chosen.append((name, words, share, float(np.sqrt(np.mean((guess - best)[use] ** 2)))))
            best_energy, best, columns = found, guess, candidate
        shapes += [Shape(channel, n, w, s, size) for n, w, s, size in chosen]
        prediction[place] = best
        before += excess
        after += best_energy - count
    share = float(np.clip((before - after) / before, 0.0, 1.0)) if before > 0 else 0.0
    return NonparametricCorrection(
        tuple(sorted(shapes, key=lambda s: -s.share)), share, prediction, max(before - after, 0.0)
    )


def _cross_predicted(
    columns: Floats, target: Floats, use: NDArray[np.bool_], folds: list[NDArray[np.bool_]]
) -> Floats:
    """Ridge fit on the other fold's samples, prediction for each fold."""
    out = np.zeros(target.size)
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    x = columns / scale
    for held in folds:
        train = use & ~held
        gram = x[train].T @ x[train]
        gram[np.diag_indices_from(gram)] += 1e-3 * np.count_nonzero(train) + 1e-9
        out[held] = x[held] @ np.linalg.solve(gram, x[train].T @ target[train])
    return out


def _groups(
    problem: LinearisedProblem, rows: list[Row], residual: Floats, limits: Limits
) -> dict[str, tuple[str, Floats]]:
    """Blocks of columns, whitened like the channel, for all of its recordings stacked."""
    builders: dict[str, tuple[str, Callable[[Part, Response, Row], Floats]]] = {
        "value": ("the channel's own value (a sensor that is not linear)", _of_value),
        "temperature": ("the film temperature, alike on both branches", _of_temperature),
        "branch": ("the film temperature, differently while heating and cooling", _of_branch),
        "rate": ("the rate of the temperature, more at some temperatures than at others", _of_rate),
        "time": ("time: a slow drift", _of_time),
        "time and temperature": ("time, more at some temperatures than at others", _of_time_and_temperature),
        "lagged drive": ("the drive's history over up to a tenth of the recording", _of_lagged_drive),
        "current": ("the current at the same instant", _of_current),
        "reversals": ("the last turning points: the shape of minor loops", _of_reversals),
        "travel": ("the distance travelled so far: wear, fatigue or training", _of_travel),
    }  # fmt: skip
    if problem.nominal.model.description.is_one_loop:  # elsewhere other channels tell a sensor from the film
        words = "time, more at some of the channel's own values than at others (a sensor that drifts)"
        builders["time and value"] = (words, _of_time_and_value)
    found = {}
    for name, (words, builder) in builders.items():
        blocks = []
        for row in rows:
            part, response = problem.parts[row.part], problem.nominal_responses[row.part]
            blocks.append(problem.whiten(row, builder(part, response, row)))
        found[name] = (words, np.concatenate(blocks))
    heat = _felt_temperature(problem, rows)
    if heat is not None:
        slow = [_spline(problem.parts[row.part].time_s, 45) for row in rows]
        found["felt temperature"] = (
            "a temperature that changes with time by itself: something else heats",
            np.concatenate(slow) * heat[:, None],
        )
    tone = _tone(problem, rows, residual, limits)
    if tone and heat is not None:
        waves = []
        for row in rows:
            phase = 2 * np.pi * tone * problem.parts[row.part].time_s
            waves.append(np.column_stack([f(k * phase) for k in (1, 2, 3) for f in (np.sin, np.cos)]))
        found["felt tone"] = (
            f"a temperature that changes periodically at {tone:.4g} Hz",
            np.concatenate(waves) * heat[:, None],
        )
    if tone:
        blocks = []
        driven = rows[0].channel == HEATER_CURRENT
        for row in rows:
            part = problem.parts[row.part]
            phase = 2 * np.pi * tone * part.time_s
            raw = np.column_stack([f(k * phase) for k in (1, 2, 3) for f in (np.sin, np.cos)])
            if driven:
                raw = np.column_stack([raw, raw * part.current[:, None]])
            blocks.append(problem.whiten(row, raw))
        cause = "a driver that ripples" if driven else "interference"
        found["tone"] = (f"time, periodically at {tone:.4g} Hz: {cause}", np.concatenate(blocks))
    return found


def _felt_temperature(problem: LinearisedProblem, rows: list[Row]) -> Floats | None:
    """Whitened change of the channel per kelvin of ambient temperature, along its recordings."""
    place_of = problem.column_of("thermal.ambient")
    if place_of is None:
        return None
    column = problem.nuisance.thermal[:, place_of] / problem.constants[place_of].spread
    place = np.concatenate([np.arange(row.where.start, row.where.stop) for row in rows])
    return np.asarray(column[place])


def _tone(problem: LinearisedProblem, rows: list[Row], residual: Floats, limits: Limits) -> float:
    """Frequency [Hz] of a line that stands out of the spectrum, refined to a tenth of a bin, else 0."""
    row = max(rows, key=lambda r: problem.parts[r.part].size)
    part = problem.parts[row.part]
    e = residual[row.where]
    frequency, power = welch(e, fs=1 / part.dt, nperseg=min(4096, part.size), detrend="constant")
    floor = np.median(power)
    # fewer cycles than that are a slow course as much as a tone
    first = max(2, int(np.searchsorted(frequency, CYCLES / (part.size * part.dt))))
    if first >= power.size:
        return 0.0
    k = int(np.argmax(power[first:])) + first
    if power[k] < limits.tone * floor:
        return 0.0
    fine = frequency[k] + np.linspace(-1.5, 1.5, 61) * (frequency[1] - frequency[0])
    phase = np.exp(-2j * np.pi * np.outer(fine, part.time_s - part.time_s[0]))
    return float(fine[np.argmax(np.abs(phase @ e))])


def _spline(x: Floats, count: int) -> Floats:
    low, high = float(np.min(x)), float(np.max(x))
    step = max(high - low, 1e-12) / (count - 1)
    knots = np.asarray(low + step * np.arange(-1.0, count + 1.0), dtype=np.float64)
    return cubic_spline(knots, x)


def _of_value(part: Part, response: Response, row: Row) -> Floats:
    return _spline(response.channels[row.channel], 40)


def _of_temperature(part: Part, response: Response, row: Row) -> Floats:
    return _spline(response.temperature, 14)


def _of_branch(part: Part, response: Response, row: Row) -> Floats:
    rising = np.gradient(response.temperature) > 0
    basis = _spline(response.temperature, 12)
    return np.column_stack([basis * rising[:, None], basis * ~rising[:, None]])


def _of_rate(part: Part, response: Response, row: Row) -> Floats:
    rate = np.gradient(response.temperature)
    rate = rate / max(float(np.sqrt(np.mean(rate**2))), 1e-12)
    basis = _spline(response.temperature, 8)
    size = np.abs(rate)
    return np.column_stack(
        [basis * rate[:, None], basis * size[:, None], basis * (np.sign(rate) * np.sqrt(size))[:, None]]
    )


def _of_time(part: Part, response: Response, row: Row) -> Floats:
    return _spline(part.time_s, 14)


def _of_time_and_temperature(part: Part, response: Response, row: Row) -> Floats:
    return _with_time(part, response.temperature)


def _of_time_and_value(part: Part, response: Response, row: Row) -> Floats:
    return _with_time(part, response.channels[row.channel])


def _with_time(part: Part, values: Floats) -> Floats:
    """Products (n, k) of slow splines of time and splines of values (n,)."""
    slow, other = _spline(part.time_s, 5), _spline(values, 6)
    return (slow[:, :, None] * other[:, None, :]).reshape(part.size, -1)


def _of_lagged_drive(part: Part, response: Response, row: Row) -> Floats:
    """What a bank of slow parallel modes would add, of the predicted value and of the temperature."""
    columns = []
    for signal in (response.channels[row.channel], response.temperature):
        centred = (signal - np.mean(signal)) / max(float(np.std(signal)), 1e-12)
        for lag in np.geomspace(1.0, max(part.size / 10, 4.0), 7):
            keep = np.exp(-1.0 / lag)
            late = lfilter([1 - keep], [1, -keep], centred, zi=[keep * centred[0]])[0]
            columns.append(late - centred)
    return np.column_stack(columns)


def _of_current(part: Part, response: Response, row: Row) -> Floats:
    steps = np.diff(part.current, prepend=part.current[:1])
    steps = steps / max(float(np.sqrt(np.mean(steps**2))), 1e-12)
    return np.column_stack([_spline(part.current, 8), steps, np.abs(steps)])


def _of_reversals(part: Part, response: Response, row: Row) -> Floats:
    last, before = turning_points(response.temperature)
    here = response.temperature
    warm = _spline(here, 6)
    extent = np.abs(here - last) / max(float(np.ptp(here)), 1e-12)
    loop = np.abs(last - before) / max(float(np.ptp(here)), 1e-12)
    rising = np.where(here > last, 1.0, -1.0)
    weights = [rising * extent, rising * loop, extent * loop, rising * np.exp(-20 * extent), loop]
    return np.column_stack([warm * w[:, None] for w in weights])


def _of_travel(part: Part, response: Response, row: Row) -> Floats:
    travel = np.cumsum(np.abs(np.diff(response.temperature, prepend=response.temperature[:1])))
    travel = travel / max(float(travel[-1]), 1e-12)
    warm = _spline(response.temperature, 6)
    rising = np.where(np.gradient(response.temperature) > 0, 1.0, -1.0)
    return np.column_stack([_spline(travel, 6), warm * travel[:, None], warm * (travel * rising)[:, None]])
