"""How an explanation does on blocks, or recordings, that it was not fitted on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.explain import Explanation, fit_jointly
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.numerics.parallel import parallel_map

__all__ = ["HeldOut", "block_folds", "held_out", "recording_folds"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOut:
    """How an explanation does on blocks it was not fitted on.

    Attributes
    ----------
    share : of the excess explained
    drop : of chi-square of the held-out blocks, given the others
    as_fitted, after, floor : channel -> root mean square in judged units: of the model as it is, explained, noise
    before : the same of the residual without the explanation, told from the model's constants along straight lines: what the
        decisions compare `after` with
    spread : largest relative spread of a parameter over the folds, in standard deviations of the fit
    stable : whether every fold agrees in sign and within a factor of two on every magnitude
    """

    share: float
    drop: float
    as_fitted: dict[str, float]
    before: dict[str, float]
    after: dict[str, float]
    floor: dict[str, float]
    stable: bool


def block_folds(problem: LinearisedProblem, *, blocks: int = 20) -> list[NDArray[np.bool_]]:
    """Return two folds of alternating long blocks of as many judged samples, each (N,) True where a sample is held out.

    Parameters
    ----------
    problem : of the recordings
    blocks : per channel and recording
    """
    odd = np.zeros(problem.weight.size, dtype=bool)
    for row in problem.rows:
        judged = problem.weight[row.where] > 0.0
        place = (np.cumsum(judged) - 1) * blocks // max(int(np.count_nonzero(judged)), 1)
        odd[row.where] = place % 2 == 1
    return [odd, ~odd]


def recording_folds(problem: LinearisedProblem, calibrations: int) -> list[NDArray[np.bool_]]:
    """Return folds of whole recordings, each (N,) True where held out: every one in turn but the calibrations.

    None where a single recording is left: what is fast or large in it, nothing else has shown.

    Parameters
    ----------
    problem : over calibrations and recordings
    calibrations : number of the first recordings, which stay; 0 for no such folds
    """
    others = range(calibrations, len(problem.parts))
    if not calibrations or len(others) < 2:
        return []
    folds = []
    for index in others:
        held = np.zeros(problem.weight.size, dtype=bool)
        for row in problem.rows:
            held[row.where] = row.part == index
        folds.append(held)
    return folds


def held_out(
    problem: LinearisedProblem,
    explanation: Explanation | None,
    limits: Limits,
    *,
    reference: LinearisedProblem | None = None,
    folds: Sequence[NDArray[np.bool_]] | None = None,
    tick: Callable[[], None] = lambda: None,
) -> HeldOut:
    """Fit on one half of the blocks, judge on the other, both ways.

    Parameters
    ----------
    problem : the problem, about the explanation where there is one
    explanation : what is judged; None judges the nuisance model alone
    limits : when two folds find the same
    reference : the problem about the nominal simulation, which the gain is told against
    folds : held-out masks; two of alternating long blocks by default
    tick : called once per simulation

    Returns
    -------
    drop of the residual's energy on what was held out, and the errors of each channel before and after
    """
    nominal = problem if reference is None else reference
    temperature = np.empty(nominal.weight.size)
    for row, _, response in nominal.iterate():
        temperature[row.where] = response.temperature

    def reached(training: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Where the training blocks have been: at other temperatures nothing was fitted that could be judged."""
        seen = temperature[training & (nominal.weight > 0)]
        return np.asarray(
            (temperature > seen.min() - limits.within_k) & (temperature < seen.max() + limits.within_k)
        )

    q_nominal = nominal.chi_square(nominal.residual)
    before_energy = after_energy = 0.0
    count = 0
    squares: dict[str, dict[str, float]] = {"as_fitted": {}, "before": {}, "after": {}}
    numbers: dict[str, int] = {}
    estimates = []
    masks = list(folds or block_folds(problem))

    def trained(held: NDArray[np.bool_]) -> tuple[LinearisedProblem, Explanation | None]:
        training = problem.restricted(~held)
        if explanation is None:
            return training, None
        hypotheses, values = explanation.hypotheses, explanation.values
        return training, fit_jointly(training, hypotheses, values, limits, iterations=3, tick=tick)

    for held, (training, fitted) in zip(masks, parallel_map(trained, masks), strict=True):
        change = np.zeros(problem.weight.size)
        if fitted is not None:
            estimates.append(fitted.values)
            change = problem.deviation(fitted.effects, fitted.shift)
        weights = training.fit_nuisance(training.residual - np.where(held, 0.0, change))
        plainly = nominal.restricted(~held)
        rest = problem.residual - change
        with_it = rest - problem.nuisance.times(weights)
        use = held & (problem.weight > 0) & reached(~held)
        # chi-square of all minus that of the training blocks: how unlikely the held-out blocks are, given the others
        before_energy += q_nominal - plainly.chi_square(plainly.residual)
        after_energy += problem.chi_square(rest) - training.chi_square(np.where(held, 0.0, rest))
        count += int(np.count_nonzero(use))
        for row in problem.rows:
            some = use[row.where]
            errors = {
                "as_fitted": nominal.residual_as_fitted(row),
                "before": problem.in_its_unit(row, nominal.residual),
                "after": problem.in_its_unit(row, with_it),
            }
            for name, plain in errors.items():
                squares[name][row.channel] = squares[name].get(row.channel, 0.0) + float(
                    np.sum(plain[some] ** 2)
                )
            numbers[row.channel] = numbers.get(row.channel, 0) + int(np.count_nonzero(some))
    excess = before_energy - count
    share = (before_energy - after_energy) / excess if excess > 0 else 0.0
    root = {
        name: {c: float(np.sqrt(v / max(numbers[c], 1))) for c, v in by.items()}
        for name, by in squares.items()
    }
    floor = {c: problem.nominal.noise[c].level for c in numbers}
    return HeldOut(
        share,
        before_energy - after_energy,
        root["as_fitted"],
        root["before"],
        root["after"],
        floor,
        _stable(problem, explanation, estimates, limits),
    )


def _stable(
    problem: LinearisedProblem,
    explanation: Explanation | None,
    estimates: Sequence[Sequence[dict[str, float]]],
    limits: Limits,
) -> bool:
    """Whether any two folds find that every effect does the same."""
    return explanation is None or all(
        _same(problem, explanation, limits, *both) for both in combinations(estimates, 2)
    )


def _same(
    problem: LinearisedProblem,
    explanation: Explanation,
    limits: Limits,
    *estimates: Sequence[dict[str, float]],
) -> bool:
    """Whether two estimates of an explanation do the same."""
    plain = replace(problem, included={})
    for index, hypothesis in enumerate(explanation.hypotheses):
        if hypothesis.key in explanation.courses:
            continue  # the line and the bend of a course trade; what both do on held-out blocks is judged there
        fitted = [n for n in explanation.values[index] if n not in hypothesis.choices]
        free = [n for n in fitted if not hypothesis.logarithmic(n)]
        shaped = len(fitted) - len(free)
        if free and not shaped:
            name = max(free, key=lambda n: abs(explanation.values[index][n]) / hypothesis.scales[n])
            first, second = (fold[index][name] for fold in estimates)
            if first * second <= 0 or not 1.0 / limits.stable < first / second < limits.stable:
                return False
            continue
        # a magnitude means little without its shape: compare what the effect does
        without = plain.responses({})
        one, other = (
            problem.stack(plain.responses(hypothesis.effects(fold[index])), without) for fold in estimates
        )
        # as it is, or what of it the nuisance model cannot take up: of a mode's slow heat that may have any part
        beyond = [problem.apply_inverse_covariance(each) for each in (one, other)]
        if not (_agree(limits, one, other, one, other) or _agree(limits, one, other, *beyond)):
            return False
    return True


def _agree(limits: Limits, one: Floats, other: Floats, left_one: Floats, left_other: Floats) -> bool:
    """Whether two whitened changes (N,) agree in pattern and in size.

    `left_one`, `left_other` : what is left of them where something else may take up a part.
    """
    own, others = float(one @ left_one), float(other @ left_other)
    if own <= 0 or others <= 0:
        return False
    most = limits.stable**2
    alike = one @ left_other >= limits.stable_cosine * np.sqrt(own * others)
    return bool(alike and 1.0 / most < own / others < most)
