"""Which law a relaxation follows by itself: logarithm of time, exponentials, a power; decided on samples not fitted.

No drive and no device here: the logarithm of one recording's resistance over the time since its pulse.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vo2_studies.measured.cases import Case

__all__ = ["LAWS", "LawResult", "compare_laws"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """y(t) = sum of columns times weights: columns depend on time constants, weights are found by least squares."""

    equation: str
    constants: int
    columns: Callable[[Floats, Floats], Floats]
    starts: tuple[tuple[float, ...], ...]


def _exponentials(t: Floats, p: Floats) -> Floats:
    return np.column_stack([np.ones_like(t), *(np.exp(-t / np.exp(q)) for q in p)])


def _logarithm(t: Floats, p: Floats) -> Floats:
    return np.column_stack([np.ones_like(t), np.log1p(t / np.exp(p[0]))])


def _stretched(t: Floats, p: Floats) -> Floats:
    # the exponent stays between 0 and 1: relaxation slower than exponential
    return np.column_stack([np.ones_like(t), np.exp(-((t / np.exp(p[0])) ** _unit(p[1])))])


def _power(t: Floats, p: Floats) -> Floats:
    return np.column_stack([np.ones_like(t), (1.0 + t / np.exp(p[0])) ** (-2.0 * _unit(p[1]))])


def _unit(x: float) -> float:
    return float(1.0 / (1.0 + np.exp(-x)))


# starting constants in logarithms of the span of time: 0 is its geometric middle, 1 its end
LAWS: dict[str, Law] = {
    "logarithm": Law("y0 + A ln(1 + t / t0)", 1, _logarithm, ((-1.0,), (0.0,), (0.7,))),
    "exponential": Law("y0 - A exp(-t / tau)", 1, _exponentials, ((-0.7,), (0.0,), (0.5,))),
    "two exponentials": Law(
        "y0 - A1 exp(-t / tau1) - A2 exp(-t / tau2)", 2, _exponentials, ((-0.7, 0.0), (-0.4, 0.4), (0.0, 0.6))
    ),
    "stretched exponential": Law(
        "y0 - A exp(-(t / tau)^b), 0 < b < 1", 2, _stretched, ((-0.7, 0.0), (0.0, 0.0), (0.4, 1.0))
    ),
    "power": Law("y0 - A (1 + t / t0)^-p, 0 < p < 2", 2, _power, ((-0.9, 0.0), (0.0, 0.0), (-0.3, 1.0))),
}


@dataclass(frozen=True)
class LawResult:
    """Errors of the laws on one recording, root mean square [log10 ohm].

    Attributes
    ----------
    label : of the recording
    between : law -> error on every other half decade, the law fitted on those between
    later : law -> error on the last part of the time (its last two thirds of a decade), fitted on all before
    """

    label: str
    between: Mapping[str, float]
    later: Mapping[str, float]


def compare_laws(case: Case) -> LawResult:
    """Fit every law to parts of a relaxation after its (last) pulse and judge it on the others."""
    thin = case.thinned()
    y = np.log10(thin.recording[case.channel])
    good = np.isfinite(y) & np.isfinite(thin.since_s)
    # after several pulses, the last
    start = int(np.flatnonzero(~np.isfinite(case.since_s) | (case.since_s == 0.0))[-1])
    good[: start + 1] = False
    t, y = thin.since_s[good], y[good]
    place = np.log10(t)
    block = np.floor((place - place[0]) / 0.5).astype(int)
    between = _errors(t, y, [block % 2 == k for k in (0, 1)])
    later = _errors(t, y, [place > place[-1] - 2.0 / 3.0])
    return LawResult(case.label, between, later)


def _errors(t: Floats, y: Floats, folds: list[NDArray[np.bool_]]) -> dict[str, float]:
    found = {}
    for name, law in LAWS.items():
        squares = [(_fitted(law, t[~held], y[~held])(t[held]) - y[held]) ** 2 for held in folds]
        found[name] = float(np.sqrt(np.mean(np.concatenate(squares))))
    return found


def _fitted(law: Law, t: Floats, y: Floats) -> Callable[[Floats], Floats]:
    """Best of the law's starts; weights are eliminated (variable projection)."""
    low, high = np.log(t[0]), np.log(t[-1])
    middle, half = 0.5 * (low + high), 0.5 * (high - low)

    def weights(p: Floats) -> Floats:
        columns = law.columns(t, p)
        return np.asarray(np.linalg.lstsq(columns, y, rcond=1e-8)[0])

    def gap(p: Floats) -> Floats:
        return np.asarray(law.columns(t, p) @ weights(p) - y)

    shaped = law.columns in (_stretched, _power)
    results = []
    for start in law.starts:
        p = middle + half * np.array(start)
        lower, upper = np.full(p.size, low - 3.0), np.full(p.size, high + 5.0)
        if shaped:
            p[1], lower[1], upper[1] = start[1], -4.0, 4.0
        results.append(least_squares(gap, p, bounds=(lower, upper), x_scale=0.3))
    best = min(results, key=lambda result: result.cost).x
    final = weights(best)
    return lambda at: np.asarray(law.columns(at, best) @ final)
