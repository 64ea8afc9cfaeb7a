"""Moved constants with the loops as the calibration left them.

Beside loops that may change their shape, a gain of the heater that has moved by some per cent is no surer than another
expansion with another shape. Where one constant or two explain by themselves nearly all that a recording differs, that is
no accident, and the loops have not changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.drift import Drift, drift_of
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.problem import LinearisedProblem

__all__ = ["constants_leave", "left_by", "moved_alone", "nearest_constant"]

Floats = NDArray[np.float64]
_TRIED, _ROUNDS, _HALVES = 3, 6, 4
"""Constants tried at each place, steps of each search, and halvings of a step that leads nowhere."""
_ENOUGH = 1e-3
"""Relative drop of the squared residual with which a search ends."""
_LAGS = ("thermal.time_constant", "driver.dead_time")
_LONGER = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Multiples of a lag from which it is searched too: one far below a sample changes nothing by small steps."""


@dataclass(frozen=True)
class _Search:
    """Constants are moved with the loops as the calibration left them.

    Attributes
    ----------
    problem : without effects
    """

    problem: LinearisedProblem

    @cached_property
    def _begin(self) -> Floats:
        """Whitened residual (N,) of the simulation that the problem is linearised about."""
        return self.problem.residual - self.problem.nuisance.thermal @ self.problem.origin

    def left(self, shift: Floats) -> Floats:
        """Whitened residual (N,) with constants moved by `shift` (t,)."""
        return np.asarray(self._begin - self.problem.stack(self.problem.responses({}, shift)))

    def columns(self, shift: Floats, places: list[int], here: Floats) -> Floats:
        """Whitened change (N, m) of the simulation per unit of each constant."""
        found = []
        for k in places:
            step = self.problem.constants[k].straight
            found.append((here - self.left(shift + step * np.eye(shift.size)[k])) / step)
        return np.stack(found, axis=1)

    def start(self, shift: Floats, place: int) -> Floats:
        """The move (t,) that the search of a constant begins at: of a lag, the best of many times what it is."""
        constant = self.problem.constants[place]
        tried = [shift]
        for factor in _LONGER if constant.name in _LAGS else ():
            tried.append(shift.copy())
            tried[-1][place] = (factor - 1.0) * constant.value / constant.spread
        return min(tried, key=lambda one: float(self.left(one) @ self.left(one)))

    def likely(self, shift: Floats, places: list[int], here: Floats) -> list[int]:
        """Those few of the places whose first steps promise to leave least, the likeliest first."""
        slopes = self.columns(shift, places, here)
        drops = (slopes.T @ here) ** 2 / np.maximum(np.sum(slopes**2, axis=0), 1e-300)
        for k, place in enumerate(places):
            there = self.left(self.start(shift, place))
            drops[k] = max(drops[k], here @ here - there @ there)
        return [places[k] for k in np.argsort(-drops)[:_TRIED]]

    def searched(self, start: Floats, places: list[int]) -> tuple[Floats, Floats]:
        """Where Gauss's and Newton's steps of some constants lead, and the residual there."""
        shift = self.start(start, places[-1])
        here = self.left(shift)
        for _ in range(_ROUNDS):
            along = np.linalg.lstsq(self.columns(shift, places, here), here, rcond=None)[0]
            before = float(here @ here)
            for half in range(_HALVES):
                trial = shift.copy()
                trial[places] += along * 0.5**half
                there = self.left(trial)
                if there @ there < before:
                    shift, here = trial, there
                    break
            if before - here @ here < _ENOUGH * before:
                break
        return shift, here


def left_by(
    problem: LinearisedProblem, effects: Mapping[str, Mapping[str, float | str]], shift: Floats
) -> float:
    """Return the squared whitened residual of the simulation with effects and moved constants, loops as calibrated.

    Parameters
    ----------
    problem : without effects
    effects : `{id: {parameter: value}}`
    shift : (t,) move of each constant in its spreads
    """
    begin = problem.residual - problem.nuisance.thermal @ problem.origin
    left = begin - problem.stack(problem.responses(effects, shift))
    return float(left @ left)


def nearest_constant(problem: LinearisedProblem) -> tuple[Floats, float]:
    """Return the move (t,) of the one constant that brings the simulation nearest to recordings, and what it leaves.

    Parameters
    ----------
    problem : without effects

    Returns
    -------
    the move, and the squared residual there over that with no constant moved, loops as the calibration left them
    """
    search, start = _Search(problem), np.zeros(len(problem.constants))
    before = search.left(start)
    free = [k for k, c in enumerate(problem.constants) if c.drifts]
    found = [search.searched(start, [k]) for k in search.likely(start, free, before)]
    shift, after = min(found, key=lambda one: float(one[1] @ one[1]))
    return shift, float(after @ after) / float(before @ before)


def constants_leave(problem: LinearisedProblem, most: int) -> float:
    """Return the squared whitened residual that a few moved constants leave, loops as the calibration left them.

    Parameters
    ----------
    problem : without effects
    most : constants at most, each the one that leaves least beside those before it
    """
    search, shift = _Search(problem), np.zeros(len(problem.constants))
    here, places = search.left(shift), list[int]()
    free = [k for k, c in enumerate(problem.constants) if c.drifts and c.part is None]
    for _ in range(min(most, len(free))):
        likely = search.likely(shift, [k for k in free if k not in places], here)
        trials = [(*search.searched(shift, [*places, k]), [*places, k]) for k in likely]
        shift, here, places = min(trials, key=lambda one: float(one[1] @ one[1]))
    return float(here @ here)


def moved_alone(problem: LinearisedProblem, limits: Limits, *, rival: float = 0.0) -> Drift | None:
    """Return the moves of few constants that explain recordings by themselves, or None where none do.

    Constants are added one by one, each the one that leaves least after a search of all that move (Gauss and Newton, with
    differences), while each stands `sigmas` deviations from zero; the deviations are those of `drift.drift_of`, or half of
    the most that what is left can have moved the constant by, and the calibration's own.

    Parameters
    ----------
    problem : without effects
    limits : `alone`, `alone_from`, `alone_gain`, `alone_lag`, `alone_misfit`, `alone_most`, `rival` and `sigmas`
    rival : squared residual that an effect in their place leaves with the same loops and no constant moved; what leaves
        little more, by `alone_beside`, explains as well

    Returns
    -------
    with as many other constants in `others` that leave no more, in units of what is left
    """
    # a dead time that is another one is an effect by its name
    free = [
        k
        for k, c in enumerate(problem.constants)
        if c.drifts and c.part is None and c.name != "driver.dead_time"
    ]
    if not free or problem.loop_origin:
        return None
    # how well the calibration has told each, in units of its move
    told = {c.name: c.spread for c in problem.constants if not c.drifts}
    known = [told.get(c.name, 0.0) / c.spread for c in problem.constants]
    search = _Search(problem)
    left, columns, searched = search.left, search.columns, search.searched

    def drift_to(shift: Floats, here: Floats, places: list[int]) -> Drift:
        """With covariance (m, m) widened for misfit over long stretches."""
        own = columns(shift, places, here)
        inverse = np.linalg.pinv(own.T @ own)
        influence = own @ inverse
        scatter = np.sum(problem.over_stretches(influence * here[:, None]) ** 2, axis=0)
        wider = np.sqrt(np.maximum(scatter / np.maximum(np.diag(inverse), 1e-300), 1.0))
        # what is left is the loops', and moves an estimate by at most its length times the plain deviation
        wider = np.maximum(wider, limits.alone_misfit * np.sqrt(here @ here))
        covariance = inverse * np.outer(wider, wider) + np.diag([known[k] ** 2 for k in places])
        return Drift(
            tuple(problem.constants[k] for k in places), shift[places], covariance.astype(np.float64), shift
        )

    shift = np.zeros(len(problem.constants))
    here = left(shift)
    total = float(here @ here)
    if total < limits.alone_from * problem.count:
        return None
    places: list[int] = []
    alone: Drift | None = None
    while len(places) < limits.alone_most:
        others = [k for k in free if k not in places]
        likely = search.likely(shift, others, here)
        trials = [(*searched(shift, [*places, k]), [*places, k]) for k in likely]
        lefts = [float(trial[1] @ trial[1]) for trial in trials]
        best, least = int(np.argmin(lefts)), min(lefts)
        drift = drift_to(*trials[best])
        variance = np.diag(drift.covariance)
        # a constant that changes nothing here has no deviation, and has not moved
        surely = np.all((drift.steps**2 >= limits.sigmas**2 * variance) & (variance > 0.0)) and _seen(
            problem, drift, limits
        )
        if least > (1.0 - limits.alone_gain) * (here @ here) or not surely:
            break
        most = least * (1.0 + limits.rival / problem.count)
        as_good = [k for k, left_by in enumerate(lefts) if k != best and left_by <= most]
        alone = replace(drift, others=tuple(drift_to(*trials[k]) for k in as_good))
        shift, here, places = trials[best]
    # with a body the noise is the sensors', without one it is the law's misfit too, which no constant can take away
    floor = 0 if problem.nominal.model.description.has_body else problem.count
    most = max(floor + limits.alone * (total - floor), limits.alone_beside * rival)
    if alone is None or here @ here > most:
        return None
    return _with_free_loops(problem, alone)


def _seen(problem: LinearisedProblem, drift: Drift, limits: Limits) -> bool:
    """Whether each lag, on a device without body, has moved by what samples can show."""
    if problem.nominal.model.description.has_body:
        return True
    least = limits.alone_lag * min(part.dt for part in problem.parts)
    lags = [
        abs(step) * c.spread for c, step in zip(drift.constants, drift.steps, strict=True) if c.name in _LAGS
    ]
    return all(lag >= least for lag in lags)


def _with_free_loops(problem: LinearisedProblem, alone: Drift) -> Drift:
    """The same constants where the refit of the loops puts them, if that is within a deviation: misfit biases it less."""
    every = drift_of(problem, problem.residual)
    free = every.of([every.constants.index(c) for c in alone.constants])
    if np.any((free.steps - alone.steps) ** 2 > np.diag(alone.covariance)):
        return alone
    weights = alone.weights.copy()
    for constant, step in zip(free.constants, free.steps, strict=True):
        weights[problem.constants.index(constant)] = step
    return replace(alone, steps=free.steps, weights=weights)
