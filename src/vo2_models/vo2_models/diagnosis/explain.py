"""Fit hypotheses: scores for all, bounded Gauss-Newton with the nuisance model refitted for those that promise most."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import HUGE
from vo2_models.diagnosis.bend import Bend
from vo2_models.diagnosis.courses import bent_by
from vo2_models.diagnosis.hypotheses import MAGNITUDE_STEP, Hypothesis
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.numerics.parallel import parallel_map

__all__ = ["Explanation", "Score", "cost", "either_way", "fit_jointly", "price", "score", "switched"]

Floats = NDArray[np.float64]
SHORTEST = 0.05
"""Shortest time between switching on and off, as a share of the recording."""
ROUNDS = 3
"""So often a magnitude is set anew while hypotheses are scored."""
PRUNED = 0.02
"""Share of the largest gain seen below which a start is not followed."""
SMALLEST, LARGEST, NEW = 1e-3, 50.0, 0.1
"""Smallest and largest effect that is looked for, in sizes of a start, and the least change of a size that says something new."""
NOTHING = 1e-9
"""Chi-square that is none: a guard against division by it."""
BRIEF = 4
"""Iterations after which a refit shows whether it is worth going on."""
CORRECTED = 4
"""Steps at most with a tangent that is corrected by the steps before, until it is taken anew."""
FORESEEN = 0.25
"""Share of the expected drop of chi-square that a step must bring for the tangent to be corrected, not taken anew."""
SETTLED = 1e-4
"""Share of the whole drop of chi-square below which a step's drop shows that the next would bring next to nothing."""
TOLD, SAME = 0.1, 0.05
"""Drop of chi-square, in units of the residual's power over the noise's, and by itself, below which two fits are the same."""
ROUNDING = 1e-6
"""Drop of chi-square that is only rounding."""
A_STEP, STUCK = 0.1, 1e-3
"""Least step of a coordinate by which a derivative is taken, and step up to which a bound holds it."""
BATCH = 8
"""Simulations judged together, on one core; one matrix product serves them all."""


@dataclass(frozen=True)
class Score:
    """How far a hypothesis gets from a starting value, without a refit of its shape.

    `visible` is the chi-square that its largest starting value would make: below some tens the recording does not excite it.
    """

    hypothesis: Hypothesis
    start: Mapping[str, float]
    gain: float
    visible: float = 0.0


@dataclass(frozen=True)
class Explanation:
    """One or more hypotheses, fitted together with the nuisance model.

    Attributes
    ----------
    hypotheses : what is added
    values : one mapping of parameter values for each
    chi_square : chi-square with them
    gain : how much they lower it
    covariance : (p, p) of the scaled coordinates
    coordinates : (hypothesis index, parameter) of each coordinate
    deviation : (N,) whitened change of the simulation
    tangent : (N, p) its derivative
    at_bound : parameters that ended at a physical bound
    shift : how far the nuisance model moved its thermal parameters, in units of their columns
    courses : key of each hypothesis that may bend in time -> how it does
    """

    hypotheses: tuple[Hypothesis, ...]
    values: tuple[dict[str, float], ...]
    chi_square: float
    gain: float
    covariance: Floats
    coordinates: tuple[tuple[int, str], ...]
    deviation: Floats = field(repr=False)
    tangent: Floats = field(repr=False)
    at_bound: tuple[str, ...] = ()
    shift: Floats = field(default_factory=lambda: np.zeros(0))
    courses: Mapping[str, Bend] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the hypotheses."""
        return tuple(h.key for h in self.hypotheses)

    @property
    def effects(self) -> dict[str, dict[str, float | str]]:
        """What `Simulation.with_effects` takes."""
        merged: dict[str, dict[str, float | str]] = {}
        for hypothesis, values in zip(self.hypotheses, self.values, strict=True):
            merged |= hypothesis.effects(values)
        return merged

    @property
    def cornered(self) -> bool:
        """Whether a parameter has gone as far as is physical, even where the data would not drive it further."""
        return any(self.hypotheses[k].ends(name, self.values[k][name]) for k, name in self.coordinates)

    def std(self, index: int, name: str) -> float:
        """Standard deviation of a parameter, 0 for one that was not fitted."""
        if (index, name) not in self.coordinates:
            return 0.0
        place = self.coordinates.index((index, name))
        unit = _unit(self.hypotheses[index], name, self.values[index][name])
        return float(np.sqrt(max(self.covariance[place, place], 0.0))) * unit

    def distance(self, index: int) -> float:
        """How far the magnitudes of a hypothesis are from nothing, in standard deviations, its shape as fitted.

        A time constant and a size may be known only together: the size is told from zero all the same.
        """
        hypothesis, values = self.hypotheses[index], self.values[index]
        own = [p for p, (k, n) in enumerate(self.coordinates) if k == index and n in hypothesis.magnitudes]
        other = [p for p, (k, n) in enumerate(self.coordinates) if k == index and p not in own]
        inside = self.covariance[np.ix_(own, own)]
        if other:
            across = self.covariance[np.ix_(own, other)]
            inside = inside - across @ np.linalg.pinv(self.covariance[np.ix_(other, other)]) @ across.T
        away = np.array([values[n] / hypothesis.scales[n] for _, n in (self.coordinates[p] for p in own)])
        return float(np.sqrt(max(away @ np.linalg.pinv(inside) @ away, 0.0)))


def cost(explanation: Explanation, problem: LinearisedProblem, limits: Limits) -> float:
    """Return chi-square, and for every parameter the logarithm of the number of effective samples, in their unit.

    Schwarz's criterion for the likelihood that the probabilities are made of; a course counts its splines.

    Parameters
    ----------
    explanation : fitted
    problem : it was fitted to
    limits : with the samples that make an effective one
    """
    splines = sum(bend.shares.size for bend in explanation.courses.values())
    return explanation.chi_square + (len(explanation.coordinates) + splines) * price(problem, limits)


def price(problem: LinearisedProblem, limits: Limits) -> float:
    """Return what one parameter costs, in chi-square, see `cost`.

    Parameters
    ----------
    problem : fitted to
    limits : with the samples that make an effective one
    """
    return limits.temper * float(np.log(max(problem.count / limits.temper, 1.0)))


def _unit(hypothesis: Hypothesis, name: str, value: float) -> float:
    """Change of the parameter per unit of its coordinate."""
    return abs(value) * hypothesis.scales[name] if hypothesis.logarithmic(name) else hypothesis.scales[name]


def score(
    problem: LinearisedProblem,
    hypotheses: Sequence[Hypothesis],
    residual: Floats,
    *,
    tick: Callable[[], None] = lambda: None,
) -> list[Score]:
    """Gain of every starting value of every hypothesis, its magnitudes chosen as if the effect were linear in them.

    An effect without a magnitude in which it is linear (a limit, say) scores what its pattern would explain at the
    best size: a start far from the truth has the pattern but overshoots.

    Parameters
    ----------
    problem : the problem
    hypotheses : what is tried
    residual : (N,) whitened, what is still to be explained; nuisance model not taken out
    tick : called once per simulation

    Returns
    -------
    the best start of each hypothesis, best hypothesis first
    """
    # what happens between samples changes a size, not whether a refit is worth it; but like is compared with like
    if problem.included:
        problem = replace(problem, nominal_responses=tuple(problem.responses({}, fine=False)))
    left = problem.apply_inverse_covariance(residual)
    best: dict[str, Score] = {h.key: Score(h, h.starts[0], 0.0) for h in hypotheses}
    trials: list[tuple[Hypothesis, dict[str, float]]] = []
    for hypothesis in hypotheses:
        if len(hypothesis.magnitudes) < 2:
            trials += [(hypothesis, dict(start)) for start in hypothesis.starts]
            continue
        combined, seen = _combined(problem, hypothesis, left, tick)
        trials += [(hypothesis, values) for values in combined]
        best[hypothesis.key] = replace(best[hypothesis.key], visible=seen)

    def products_of(
        some: Sequence[tuple[Hypothesis, Mapping[str, float]]],
    ) -> tuple[list[float], list[float]]:
        """Of each start v the products r'C^-1 v and v'C^-1 v, r the residual."""
        columns = np.column_stack([problem.deviation(h.effects(v), fine=False) for h, v in some])
        for _ in some:
            tick()
        return (left @ columns).tolist(), problem.chi_squares(columns).tolist()

    for _ in range(ROUNDS):
        again: list[tuple[float, Hypothesis, dict[str, float]]] = []
        batches = [trials[first : first + BATCH] for first in range(0, len(trials), BATCH)]
        for some, products in zip(batches, parallel_map(products_of, batches), strict=True):
            for (hypothesis, values), a, o in zip(some, *products, strict=True):
                gain = 2.0 * a - o
                if not hypothesis.magnitudes and a > 0 and o > NOTHING:
                    gain = a * a / o
                known = best[hypothesis.key]
                if gain > known.gain:
                    known = replace(known, start=values, gain=gain)
                best[hypothesis.key] = replace(known, visible=max(known.visible, o))
                better = _rescaled(hypothesis, values, a, o)
                if better:
                    again.append((a * a / o, hypothesis, better))
        trials = _promising(again)
    return sorted(best.values(), key=lambda s: -s.gain)


def _promising(
    again: Sequence[tuple[float, Hypothesis, dict[str, float]]],
) -> list[tuple[Hypothesis, dict[str, float]]]:
    """What is worth a simulation at its better size: the best two of each hypothesis, and none far behind all others."""
    most = max((gain for gain, _, _ in again), default=0.0)
    count: dict[str, int] = {}
    kept = []
    for gain, hypothesis, values in sorted(again, key=lambda item: -item[0]):
        count[hypothesis.key] = count.get(hypothesis.key, 0) + 1
        if count[hypothesis.key] <= 2 and gain > PRUNED * most:
            kept.append((hypothesis, values))
    return kept


def _combined(
    problem: LinearisedProblem, hypothesis: Hypothesis, left: Floats, tick: Callable[[], None]
) -> tuple[list[dict[str, float]], float]:
    """Starts of a hypothesis with several magnitudes: for every shape the sizes that explain most together.

    Returns
    -------
    starts, and the largest chi-square that a magnitude alone would make at its typical size
    """
    names = hypothesis.magnitudes
    # on a short recording what would be visible may be more than is physical
    units = {n: min(hypothesis.scales[n] / MAGNITUDE_STEP, hypothesis.bounds(n)[1]) for n in names}
    shapes = {tuple((n, v) for n, v in start.items() if n not in names): None for start in hypothesis.starts}
    # the others beside the first: one may mean nothing without it
    trials = [
        {**dict(shape), **dict.fromkeys(names, 0.0), names[0]: units[names[0]], n: units[n]}
        for shape in shapes
        for n in names
    ]
    columns = np.column_stack(problem.deviations([hypothesis.effects(v) for v in trials], fine=False))
    for _ in trials:
        tick()
    for k in range(columns.shape[1]):
        if k % len(names):
            columns[:, k] -= columns[:, k - k % len(names)]
    projected = problem.apply_inverse_covariance(columns)
    starts = []
    for k, shape in enumerate(shapes):
        own = slice(k * len(names), (k + 1) * len(names))
        gram = columns[:, own].T @ projected[:, own]
        size = np.linalg.lstsq(gram, left @ columns[:, own], rcond=1e-6)[0]
        values = {
            n: float(np.clip(x * units[n], *hypothesis.bounds(n))) for n, x in zip(names, size, strict=True)
        }
        starts.append({**dict(shape), **values})
    return starts, float(np.max(np.sum(columns * projected, axis=0)))


def _rescaled(
    hypothesis: Hypothesis, values: Mapping[str, float], along: float, own: float
) -> dict[str, float] | None:
    """The start with the magnitude that is best if the effect is linear in it; None where that says nothing new."""
    names = [n for n in hypothesis.magnitudes if values[n] != 0.0]
    if not names or own < NOTHING:
        return None
    factor = along / own
    if not SMALLEST < abs(factor) < LARGEST or abs(factor - 1) < NEW:
        return None
    factor = min(max(factor, -5.0), 5.0)
    better = {
        n: float(np.clip(v * factor, *hypothesis.bounds(n))) if n in names else v for n, v in values.items()
    }
    return better if any(better[n] != 0.0 for n in names) else None


def switched(
    problem: LinearisedProblem,
    hypothesis: Hypothesis,
    start: Mapping[str, float],
    residual: Floats,
    *,
    tick: Callable[[], None] = lambda: None,
) -> dict[str, float]:
    """Return start values with the times of switching found by search: a fit by derivatives does not see past an edge.

    Each time is moved by a twentieth of the recording, then by half of that and so on, as long as the gain with the best
    magnitude grows.

    Parameters
    ----------
    problem : without the effect
    hypothesis : the effect
    start : its values, by parameter
    residual : (N,) whitened
    tick : called once per simulation
    """
    values = dict(start)
    names = [n for n in hypothesis.switches if abs(values.get(n, np.inf)) < HUGE]
    if not names:
        return values
    left = problem.apply_inverse_covariance(residual)
    length = max(part.size * part.dt for part in problem.parts)

    def judged(trials: Sequence[Mapping[str, float]]) -> list[tuple[float, float]]:
        columns = np.column_stack(problem.deviations([hypothesis.effects(v) for v in trials]))
        for _ in trials:
            tick()
        along, own = left @ columns, np.maximum(problem.chi_squares(columns), NOTHING)
        return [(float(a * abs(a) / o), float(a / o)) for a, o in zip(along, own, strict=True)]

    best, factor = judged([values])[0]
    step = length / 20
    while step > max(part.dt for part in problem.parts):
        trials = [{**values, n: values[n] + sign * step} for n in names for sign in (1.0, -1.0)]
        if len(names) == 2:  # what is on for a moment only is no change of the rig but a disturbance
            trials = [t for t in trials if t[names[1]] - t[names[0]] > SHORTEST * length] or [values]
        found = judged(trials)
        place = max(range(len(trials)), key=lambda k: found[k][0])
        if found[place][0] > best:
            values, (best, factor) = trials[place], found[place]
        else:
            step *= 0.5
    return {
        n: float(np.clip(v * factor, *hypothesis.bounds(n)))
        if n not in (*hypothesis.switches, *hypothesis.choices) and not hypothesis.logarithmic(n)
        else v
        for n, v in values.items()
    }


def fit_jointly(
    problem: LinearisedProblem,
    hypotheses: Sequence[Hypothesis],
    starts: Sequence[Mapping[str, float]],
    limits: Limits,
    *,
    iterations: int = 12,
    tick: Callable[[], None] = lambda: None,
) -> Explanation:
    """Bounded Levenberg-Marquardt in the parameters of all hypotheses, the nuisance model refitted at every step.

    Parameters
    ----------
    problem : the problem, or a part of it (`LinearisedProblem.restricted`)
    hypotheses, starts : what is added, and where to begin
    limits : when a bound matters
    iterations : at most
    tick : called once per simulation

    Returns
    -------
    the best values, their covariance, and the drop of chi-square against no effect
    """
    values = [dict(start) for start in starts]
    coordinates = tuple(
        (k, name) for k, start in enumerate(values) for name in start if name not in hypotheses[k].choices
    )
    descent = _Joint(problem, tuple(hypotheses), coordinates, tick)
    shift = problem.origin.copy()
    values, change, chi = descent.descend(values, shift, iterations)
    for _ in range(2):
        moved = problem.fit_nuisance(problem.residual - change)[-shift.size :] if shift.size else shift
        if not shift.size or problem.curved(moved - shift) < 1.0:
            break
        tangent = descent.tangent
        trial = descent.descend(values, moved, 4)
        if trial[2] >= chi:  # the nuisance model is not linear that far
            descent.tangent = tangent
            break
        (values, change, chi), shift = trial, moved
    if not descent.tangent.size:
        descent.linearise(values, change, shift)
    left = problem.apply_inverse_covariance(descent.tangent)
    covariance = _covariance(problem, descent.tangent, left, problem.residual - change)
    # a shape that hardly shows, and would gain nothing beyond its bound, is nowhere
    curvature = np.sum(descent.tangent * left, axis=0)
    beyond = (left.T @ (problem.residual - change)) ** 2 / np.maximum(curvature, NOTHING)
    shows = (curvature > limits.bound_shows) | (beyond > limits.bound_forgone)
    at_bound = tuple(
        f"{hypotheses[k].key}.{name}"
        for place, (k, name) in enumerate(coordinates)
        if shows[place] and hypotheses[k].ends(name, values[k][name])
    )
    return Explanation(
        tuple(hypotheses), tuple(values), chi, problem.residual_chi_square - chi, covariance, coordinates, change,
        descent.tangent, at_bound, shift, bent_by(problem, problem.residual - change),
    )  # fmt: skip


def either_way(
    problem: LinearisedProblem,
    fit: Explanation,
    limits: Limits,
    *,
    tick: Callable[[], None] = lambda: None,
) -> Explanation:
    """Return the best of the alternatives that effects have, each refitted: a start may be too far off to tell.

    Of several magnitudes one that went to its bound may trade with a constant: without it the fit may find back.

    Parameters
    ----------
    problem : that it was fitted to
    fit : with one of them
    limits : when a bound matters
    tick : called once per simulation
    """
    best = fit
    for k, hypothesis in enumerate(fit.hypotheses):
        for name in (n for n in hypothesis.choices if n in fit.values[k]):
            values = [dict(v) for v in best.values]
            values[k][name] = 1.0 - values[k][name]
            other = fit_jointly(problem, fit.hypotheses, values, limits, iterations=BRIEF, tick=tick)
            best = min(best, other, key=lambda e: e.chi_square)
        ends = [name for name in hypothesis.magnitudes if f"{hypothesis.key}.{name}" in best.at_bound]
        if ends and any(name in best.values[k] for name in hypothesis.magnitudes if name not in ends):
            values = [dict(v) for v in best.values]
            values[k] = {name: value for name, value in values[k].items() if name not in ends}
            other = fit_jointly(problem, fit.hypotheses, values, limits, tick=tick)
            best = min(best, other, key=lambda e: e.chi_square)
    return best


def _covariance(
    problem: LinearisedProblem, tangent: Floats, left: Floats, residual: Floats, blocks: int = 24
) -> Floats:
    """Covariance of the coordinates, widened for misfit that is correlated over long stretches.

    The sandwich H^-1 S H^-1 with the scores summed over long blocks: what the model says where the residual is
    noise, and what the scatter between blocks says where it is not. The scores are taken with what the nuisance model leaves
    of the tangent: of the tangent itself, blocks would scatter by what cancels between them.
    """
    if not tangent.shape[1]:
        return np.zeros((0, 0))
    inverse = np.linalg.pinv(tangent.T @ left + 1e-9 * np.eye(tangent.shape[1]))
    remaining = problem.apply_inverse_covariance(residual)
    scores = []
    for row, part, _ in problem.iterate():
        edges = np.arange(blocks) * part.size // blocks
        scores.append(np.add.reduceat(left[row.where] * remaining[row.where, None], edges, axis=0))
    # a block of time is one piece of evidence for all channels together
    summed: dict[int, Floats] = {}
    for (row, _, _), block in zip(problem.iterate(), scores, strict=True):
        summed[row.part] = summed.get(row.part, 0.0) + block
    stacked = np.concatenate(list(summed.values()))
    spread = stacked.T @ stacked
    sandwich = inverse @ spread @ inverse
    wider = np.maximum(
        np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-300), 0.0)), 1.0
    )
    return np.asarray(inverse * np.outer(wider, wider))


class _Joint:
    """Levenberg-Marquardt in the coordinates of several hypotheses; the nuisance model is eliminated at every step."""

    def __init__(
        self,
        problem: LinearisedProblem,
        hypotheses: tuple[Hypothesis, ...],
        coordinates: tuple[tuple[int, str], ...],
        tick: Callable[[], None],
    ) -> None:
        self.problem, self.hypotheses, self.coordinates, self.tick = problem, hypotheses, coordinates, tick
        self.tangent: Floats = np.zeros((problem.weight.size, 0))

    def deviation(self, at: Sequence[Mapping[str, float]], shift: Floats) -> Floats:
        """Whitened change of the simulation."""
        self.tick()
        return self.problem.deviation(self._merged(at), shift)

    def _merged(self, at: Sequence[Mapping[str, float]]) -> dict[str, dict[str, float | str]]:
        merged: dict[str, dict[str, float | str]] = {}
        for hypothesis, given in zip(self.hypotheses, at, strict=True):
            merged |= hypothesis.effects(given)
        return merged

    def linearise(self, values: Sequence[Mapping[str, float]], change: Floats, shift: Floats) -> None:
        """Set `tangent` (N, p) by differences."""
        tangent = np.zeros((change.size, len(self.coordinates)))
        trials, lengths, places = [], [], []
        for place, (k, name) in enumerate(self.coordinates):
            for step in (0.5, -0.5):  # at a bound: look the other way
                moved = [dict(v) for v in values]
                moved[k][name] = self.hypotheses[k].moved(name, values[k][name], step)
                actual = self.hypotheses[k].distance(name, values[k][name], moved[k][name])
                if abs(actual) > A_STEP:
                    trials.append(self._merged(moved))
                    lengths.append(actual)
                    places.append(place)
                    self.tick()
                    break
        changes = self.problem.deviations(trials, shift)
        for place, length, moved_change in zip(places, lengths, changes, strict=True):
            tangent[:, place] = (moved_change - change) / length
        self.tangent = tangent

    def descend(
        self, start: Sequence[Mapping[str, float]], shift: Floats, iterations: int
    ) -> tuple[list[dict[str, float]], Floats, float]:
        """Return values, change and chi-square at the minimum near the start.

        The tangent is taken by differences at most `iterations` times. In between, where a step did nearly what was
        expected, it is corrected by what the step showed (Broyden's rank-one update), which needs no simulation. The
        end is where no step is expected to lower chi-square by anything that the residual could tell.
        """
        problem, target = self.problem, self.problem.residual
        nuisance = problem.nuisance
        values = [dict(v) for v in start]
        change = self.deviation(values, shift)
        # what the nuisance model makes of a vector v comes from B'v alone, which is followed along: the nuisance model is long
        rest = target - change
        rest_seen = nuisance.against(rest)
        chi = chi_first = problem.chi_square(rest, rest_seen)
        damping = 1e-3

        def matters(drop: float, share: float) -> bool:
            return drop > max(TOLD * chi / max(problem.count, 1), share * (chi_first - chi), SAME)

        for _ in range(iterations):
            self.linearise(values, change, shift)
            tangent_seen = nuisance.against(self.tangent)
            chi_here, ended = chi, False
            for corrected in range(1 + CORRECTED):
                taken = problem.nuisance_weights(tangent_seen)
                normal = self.tangent.T @ self.tangent - tangent_seen.T @ taken
                right = self.tangent.T @ rest - taken.T @ rest_seen
                free = self._free(values, right)
                most = float(
                    right[free] @ np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True) @ right[free]
                )
                if not matters(most, 0.0):
                    ended = True
                    break
                improved = False
                for _ in range(2 if corrected else 5):
                    trial, moved = self._step(values, normal, right, free, damping)
                    expected = float(moved @ (2.0 * right - normal @ moved))
                    if expected > 0.0:
                        new = self.deviation(trial, shift)
                        rest_new = target - new
                        new_seen = nuisance.against(rest_new)
                        chi_new = problem.chi_square(rest_new, new_seen)
                        if chi_new < chi - ROUNDING:
                            improved = True
                            break
                    damping = max(damping * 30, 1e-3)
                if not improved:
                    break
                drop, unforeseen = chi - chi_new, new - change - self.tangent @ moved
                unforeseen_seen = rest_seen - new_seen - tangent_seen @ moved
                values, change, chi, rest, rest_seen = trial, new, chi_new, rest_new, new_seen
                damping = max(damping * 0.2, 1e-6)
                if drop < FORESEEN * expected or not matters(drop, SETTLED):
                    break
                along = moved / float(moved @ moved)
                self.tangent = self.tangent + np.outer(unforeseen, along)
                tangent_seen = tangent_seen + np.outer(unforeseen_seen, along)
            if ended or not matters(chi_here - chi, SETTLED):
                break
        return values, change, chi

    def _free(self, values: Sequence[Mapping[str, float]], right: Floats) -> NDArray[np.bool_]:
        """Coordinates (p,) that no bound stops on the way down."""
        free = np.ones(right.size, dtype=bool)
        for place, (k, name) in enumerate(self.coordinates):
            hypothesis, old = self.hypotheses[k], values[k][name]
            there = hypothesis.moved(name, old, float(np.sign(right[place])))
            free[place] = abs(hypothesis.distance(name, old, there)) > STUCK
        return free

    def _step(
        self,
        values: Sequence[Mapping[str, float]],
        normal: Floats,
        right: Floats,
        free: NDArray[np.bool_],
        damping: float,
    ) -> tuple[list[dict[str, float]], Floats]:
        """Values after a damped step of the free coordinates, inside the bounds, and the step (p,) that this was."""
        own = normal[np.ix_(free, free)]
        step = np.zeros(right.size)
        step[free] = np.linalg.solve(own + np.diag(damping * np.diag(own) + 1e-9), right[free])
        step *= min(1.0, 30.0 / max(float(np.max(np.abs(step))), 1e-300))  # all together: parameters trade
        trial = [dict(v) for v in values]
        moved = np.zeros(right.size)
        for place, (k, name) in enumerate(self.coordinates):
            hypothesis, old = self.hypotheses[k], values[k][name]
            trial[k][name] = hypothesis.moved(name, old, float(step[place]))
            moved[place] = hypothesis.distance(name, old, trial[k][name])
        return trial, moved
