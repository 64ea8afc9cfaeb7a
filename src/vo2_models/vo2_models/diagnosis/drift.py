"""Which constants have moved since the calibration, how far, and how surely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from vo2_models.diagnosis.explain import Explanation
from vo2_models.diagnosis.nuisance import Constant
from vo2_models.diagnosis.problem import LinearisedProblem

__all__ = ["Drift", "days_differ", "drift_of"]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Drift:
    """Posterior of the constants that another day may have moved.

    Attributes
    ----------
    constants : the constants
    steps : (d,) posterior mean, in units of each constant's `spread`
    covariance : (d, d) of the steps, what the calibration left open included, widened for misfit that is correlated over
        long stretches
    weights : (t,) of all thermal columns, every constant free
    others : other constants that explain as much by themselves, see `moved_alone`
    """

    constants: tuple[Constant, ...]
    steps: Floats
    covariance: Floats
    weights: Floats
    others: tuple[Drift, ...] = ()

    @property
    def chi_square(self) -> float:
        """Squared move over its covariance: of an unchanged device a chi-square of d degrees of freedom."""
        return float(self.steps @ np.linalg.pinv(self.covariance, hermitian=True) @ self.steps)

    @property
    def _logarithm(self) -> Floats:
        """Move (d,) of the logarithm of a gain of the resistance, which is what was fitted; 0 of all others."""
        of = [c.name == "resistance.gain" for c in self.constants]
        return np.where(of, np.clip(self._spread * self.steps, -50.0, 50.0), 0.0)

    @property
    def _spread(self) -> Floats:
        return np.array([c.spread for c in self.constants])

    @property
    def move(self) -> Floats:
        """Posterior mean (d,), in each constant's unit."""
        logarithm = self._logarithm
        return np.where(logarithm, np.expm1(logarithm), self._spread * self.steps)

    @property
    def std(self) -> Floats:
        """Posterior standard deviation (d,), in each constant's unit."""
        return np.asarray(np.exp(self._logarithm) * self._spread * np.sqrt(np.diag(self.covariance)))

    @property
    def sigmas(self) -> Floats:
        """Distance (d,) of each constant from where it was, in standard deviations."""
        return np.asarray(np.abs(self.move) / self.std)

    def widened(self, by: float) -> Drift:
        """Return the same with standard deviations `by` times as large, where more than noise is left.

        Birge's ratio: Phys. Rev. 40, 207, 1932.

        Parameters
        ----------
        by : r.m.s. of what is left over that of the noise, 1 or more
        """
        return replace(self, covariance=by**2 * self.covariance)

    def significant(self, probability: float) -> bool:
        """Whether unchanged constants would move as far with at most this probability."""
        return bool(self.chi_square > chi2.isf(probability, len(self.constants)))

    def of(self, places: Sequence[int]) -> Drift:
        """Return the moves of some constants, the others held where they were: P_SS^-1 b_S, see `fewest`.

        Parameters
        ----------
        places : of the constants, in the order of the answer
        """
        own = list(places)
        precision = np.linalg.pinv(self.covariance, hermitian=True)
        covariance = np.linalg.pinv(precision[np.ix_(own, own)], hermitian=True)
        steps = covariance @ (precision @ self.steps)[own]
        return replace(
            self, constants=tuple(self.constants[k] for k in own), steps=steps, covariance=covariance
        )

    def fewest(self, probability: float, rival: float) -> list[Drift]:
        """Return the moves of the fewest constants beside which no other has moved, the likeliest set first.

        Gain, zero and room do nearly the same in a response: free together each is uncertain, though one of them alone
        explains what all do. With precision P = C^-1, b = P m, those of a set S free and all others where they were move to
        P_SS^-1 b_S with covariance P_SS^-1, and the squared move that is left, m'b - b_S' P_SS^-1 b_S, is a chi-square of the
        others' number if these have not moved.

        Parameters
        ----------
        probability : of what is left, for others that have not moved, above which none of them has
        rival : difference of chi-square up to which another set of as many is not told from the likeliest

        Returns
        -------
        one or more, each of its constants only; `others` last
        """
        precision = np.linalg.pinv(self.covariance, hermitian=True)
        along = precision @ self.steps
        total, items = len(self.constants), self._items()

        def moved(some: Sequence[tuple[int, ...]]) -> tuple[bool, int, float, Drift]:
            """Whether no other has moved beside some items, how many constants these are, what is left, and their moves."""
            places = sorted({k for item in some for k in item})
            drift = self.of(places)
            left = float(self.steps @ along - drift.steps @ along[places])
            others = total - len(places)
            return not others or left <= chi2.isf(probability, others), len(places), left, drift

        for size in range(1, len(items) + 1):
            found = [moved(some) for some in combinations(items, size)]
            if enough := [one[1:3] for one in found if one[0]]:
                break
        # a room of each recording's own leaves less than one of all, and is no rival of that
        count, least = min(enough)
        near = [one for one in found if one[1] == count and one[2] <= least + rival]
        return [*(one[3] for one in sorted(near, key=lambda one: one[2])), *self.others]

    def _items(self) -> list[tuple[int, ...]]:
        """Places of each constant, and of all columns of one that is another one in each recording."""
        common = [(k,) for k, c in enumerate(self.constants) if c.part is None]
        names = dict.fromkeys(c.name for c in self.constants if c.part is not None)
        return common + [tuple(k for k, c in enumerate(self.constants) if c.name == name) for name in names]

    def of_each_recording(self, sigmas: float) -> Drift:
        """Return the same told by recording: of a constant that is another one in each, what it is there in all.

        Parameters
        ----------
        sigmas : standard deviations that such a one has moved by at least to be told; the surest is told in any case
        """
        own = {c.name for c in self.constants if c.part is not None}
        kept = [k for k, c in enumerate(self.constants) if c.part is not None or c.name not in own]
        into = np.zeros((len(kept), len(self.constants)))
        for row, k in enumerate(kept):
            constant = self.constants[k]
            for place, c in enumerate(self.constants):
                if place == k or (c.part is None and c.name == constant.name):
                    into[row, place] = c.spread / constant.spread
        every = replace(
            self,
            constants=tuple(self.constants[k] for k in kept),
            steps=into @ self.steps,
            covariance=into @ self.covariance @ into.T,
        )
        sure = np.array([c.part is None for c in every.constants]) | (every.sigmas >= sigmas)
        sure[np.argmax(every.sigmas)] = True
        return replace(
            every,
            constants=tuple(c for c, told in zip(every.constants, sure, strict=True) if told),
            steps=every.steps[sure],
            covariance=every.covariance[np.ix_(sure, sure)],
        )


def drift_of(problem: LinearisedProblem, residual: Floats, chosen: Explanation | None = None) -> Drift:
    """Return the posterior of the drifting constants.

    The covariance C is (B'B + I)^-1 of the whole nuisance model. It is widened by the sandwich: the influence of each
    sample on an estimate, times what is left of the residual, summed over long stretches, scatters as the deviation says
    only if the residual is noise. Beside an effect, with tangent T (N, p) and covariance S (p, p) of its parameters,
    (C B'T) S (C B'T)' is added: a gain and a creep that goes on all the time trade off.

    Parameters
    ----------
    problem : without effects, or about those of `chosen`
    residual : (N,) whitened, about the model's own constants, what `chosen` explains taken out
    chosen : what is named beside
    """
    first = problem.nuisance.shape[1] - len(problem.constants)
    places = [k for k, c in enumerate(problem.constants) if c.drifts]
    constants = tuple(problem.constants[k] for k in places)
    unit = np.zeros((problem.nuisance.shape[1], len(places)))
    unit[[first + k for k in places], np.arange(len(places))] = 1.0
    inverse = problem.nuisance_weights(unit)
    covariance = inverse[[first + k for k in places]]
    influence = problem.nuisance.times(inverse)
    weights = problem.fit_nuisance(residual)
    left = residual - problem.nuisance.times(weights)
    scatter = np.sum(problem.over_stretches(influence * left[:, None]) ** 2, axis=0)
    plain = np.sum(influence**2, axis=0)
    wider = np.sqrt(np.maximum(scatter / np.maximum(plain, 1e-300), 1.0))
    scaled = covariance * np.outer(wider, wider)
    if chosen is not None:
        across = influence.T @ chosen.tangent
        scaled = scaled + across @ chosen.covariance @ across.T
    return Drift(constants, weights[first:][places], scaled, weights[first:])


def days_differ(problem: LinearisedProblem, residual: Floats, probability: float) -> bool:
    """Return whether constants that are taken to be the same in all recordings are not.

    Parameters
    ----------
    problem : over several recordings
    residual : (N,) whitened, about the model's own constants, what is named taken out
    probability : as `Drift.significant` takes it
    """
    common = [(place, c) for place, c in enumerate(problem.constants) if c.held]
    own = {c.name for c in problem.constants if c.part is not None}
    columns, constants = [], []
    for part in range(1, len(problem.parts)):
        here = np.zeros(problem.weight.size, dtype=np.bool_)
        for row in problem.rows:
            here[row.where] = row.part == part
        for place, constant in common:
            if constant.name not in own:
                columns.append(np.where(here, problem.nuisance.thermal[:, place], 0.0))
                constants.append(replace(constant, part=part))
    if not columns:
        return False
    thermal = np.column_stack([problem.nuisance.thermal, *columns])
    wider = replace(
        problem,
        nuisance=replace(problem.nuisance, thermal=thermal),
        constants=(*problem.constants, *constants),
    )
    drift = drift_of(wider, residual)
    added = slice(len(drift.constants) - len(constants), None)
    return replace(
        drift,
        constants=tuple(constants),
        steps=drift.steps[added],
        covariance=drift.covariance[added, added],
    ).significant(probability)
