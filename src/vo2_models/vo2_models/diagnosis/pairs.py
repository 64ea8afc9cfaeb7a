"""More than one effect: a second beside the first, and each of the two tried anew beside the other.

The first name was chosen as if it were alone, so it may stand for something that resembles both truths. Once a
second is found, every effect is tried in the place of the first, then again in that of the second, until the pair
stays: what is named is the pair that explains most, not the first and what suits it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.courses import constants_like, with_courses
from vo2_models.diagnosis.explain import (
    BRIEF,
    Explanation,
    Score,
    cost,
    either_way,
    fit_jointly,
    score,
    switched,
)
from vo2_models.diagnosis.hypotheses import Hypothesis, windowed
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.problem import LinearisedProblem, linearise_problem
from vo2_models.numerics.parallel import parallel_map

__all__ = ["Option", "option_of", "pair_of", "refit_about", "trace"]

Floats = NDArray[np.float64]
Tick = Callable[[], None]
PARTNERS = 5
"""Effects that are refitted beside another, the most promising ones."""
BRIEF_BESIDE = 2
"""Iterations after which a refit beside another effect shows whether it is worth going on."""
EXCHANGES = 3
"""So often one of the two is tried anew beside the other."""
REFITS = 5
"""So often, at most, the nominal device is linearised about what a refit made of it."""
SETTLES = 2e-3
"""Drop of chi-square, in noise powers, that ends these refits."""
FAR = 1.0
"""Move of a constant, in units of what the simulation is linear over, from which an effect is also fitted with none moved."""
FREE = 20.0
"""Standard deviation with which the parameters of the other may move while partners are scored, in their steps."""


@dataclass(frozen=True)
class Option:
    """One or two effects that may be the answer.

    Attributes
    ----------
    final : the problem about them
    chosen : the explanation
    rivals : the same number of effects with one replaced, best first
    remaining : excess power over noise power that they leave
    """

    final: LinearisedProblem
    chosen: Explanation
    rivals: tuple[Explanation, ...]
    remaining: float


def trace(final: LinearisedProblem, key: str = "") -> Floats:
    """Return what the effects that the problem is about change in the recording, (N,) whitened, without noise.

    Parameters
    ----------
    final : about the effects
    key : of one of them, beside the others; all together by default
    """
    others = {name: values for name, values in final.included.items() if key and name != key}
    plain = replace(final, included=others)
    bends = key in final.courses if key else bool(final.courses)
    bent = final.nuisance.of_courses(final.fit_nuisance(final.residual)) - final.bent if bends else 0.0
    return bent - plain.stack(plain.responses({}), final.nominal_responses)


def option_of(
    nominal: Nominal,
    problem: LinearisedProblem,
    best: Explanation,
    rivals: Sequence[Explanation],
    limits: Limits,
    *,
    tick: Tick = lambda: None,
) -> Option:
    """Return an explanation, fitted once more, with the problem about it.

    Parameters
    ----------
    nominal : without corrections
    problem : the problem about the simulation without effects, which gains are told against
    best : the explanation
    rivals : what else was tried
    limits : when a bound matters
    tick : called once per simulation
    """
    final, chosen = refit_about(nominal, problem, best, limits, tick=tick)
    remaining = final.chi_square(final.residual - chosen.deviation) / final.count - 1.0
    return Option(final, chosen, tuple(rivals), remaining)


def refit_about(
    nominal: Nominal,
    problem: LinearisedProblem,
    best: Explanation,
    limits: Limits,
    *,
    tick: Tick = lambda: None,
) -> tuple[LinearisedProblem, Explanation]:
    """Build the problem about an explanation, with the same constants, and fit it once more there; return both.

    Parameters
    ----------
    nominal : without corrections
    problem : about the simulation without effects, which the gain is told against
    best : the explanation
    limits : when a bound matters
    tick : called once per simulation
    """

    def about(
        shift: Floats, fit: Explanation, final: LinearisedProblem
    ) -> tuple[LinearisedProblem, Explanation]:
        rest = final.residual - fit.deviation
        courses = {h.key: fit.courses[h.key] for h in followed}
        for place, weight in held.items():
            for key, bend in courses.items():  # what the constant does the course does
                courses[key] = bend.raised(weight * shift[place])
        shift = np.where(np.isin(np.arange(shift.size), list(held)), 0.0, shift)
        there = linearise_problem(
            nominal,
            problem.parts,
            shift=shift,
            constants=problem.constants,
            effects=fit.effects,
            shapes=problem.shapes,
            loops=final.loops,
            loop_origin=final.loop_weights(final.fit_nuisance(rest)) if problem.refits else {},
            refits=problem.refits,
            courses=courses,
        )
        there = with_courses(there, [h for h in best.hypotheses if h.key in best.courses], tuple(held))
        fit = fit_jointly(there, best.hypotheses, fit.values, limits, iterations=6, tick=tick)
        return there, either_way(there, fit, limits, tick=tick)

    followed = [h for h in best.hypotheses if h.key in best.courses and h.record.takes_course][:1]
    held = constants_like(problem, followed[0]) if followed else {}
    final, again = problem, best
    turns, turn = 1 + REFITS * (problem.refits or bool(followed)), 0
    while turn < turns:
        # fitted with constants as the calibration left them, perhaps: those that drift come last
        shift = np.pad(again.shift, (0, problem.origin.size - again.shift.size))
        tried = [about(shift, again, final)]
        much = tried[0][1].chi_square > (1.0 + limits.least) * tried[0][0].count
        if not turn and much and problem.curved(shift) > FAR and not problem.refits:
            # constants that went far to stand for the effect need not find back
            tried.append(about(np.zeros_like(shift), again, final))
            turns = max(turns, 2)
        there, fitted = min(tried, key=lambda one: one[1].chi_square)
        if turn and fitted.chi_square > again.chi_square - SETTLES * there.count:
            break
        final, again = there, fitted
        turn += 1
    return final, replace(again, gain=problem.residual_chi_square - again.chi_square)


def pair_of(
    nominal: Nominal,
    problem: LinearisedProblem,
    alone: Option,
    candidates: Sequence[Hypothesis],
    limits: Limits,
    *,
    tick: Tick = lambda: None,
) -> Option | None:
    """Look for two effects that explain more than the first alone; None if no other is worth it.

    What an equation that is not quite right leaves over resembles what it explains: a second effect that acts like the
    first must gain more than such an equation can leave. How likely it is that the two are wrong is judged with the options.

    Parameters
    ----------
    nominal : without corrections
    problem : the problem about the simulation without effects
    alone : the best single effect
    candidates : all hypotheses
    limits : when a second effect counts
    tick : called once per simulation

    Returns
    -------
    both effects with the problem about them, or None
    """
    about, first = alone.final, alone.chosen
    before = about.chi_square(about.residual - first.deviation)
    found = [(about, joint) for joint in _joined(about, first, candidates, limits, tick)]
    if not found:
        return None
    if before - found[0][1].chi_square < limits.hopeless * (before - about.count):
        return None
    waiting = _untried([joint for _, joint in found], about.count, limits)
    tried = {first.keys[0]}
    # a first effect that leaves next to nothing is no stand-in for two others
    for _ in range(EXCHANGES if alone.remaining > limits.slack else 0):
        key = next((key for key in waiting if key not in tried), None)
        if key is None:
            break
        tried.add(key)
        one = fit_jointly(problem, *waiting[key], limits, iterations=BRIEF, tick=tick)
        there, kept = refit_about(nominal, problem, one, limits, tick=tick)
        fresh = _joined(there, kept, candidates, limits, tick)
        found += [(there, joint) for joint in fresh]
        waiting |= _untried(fresh, about.count, limits)
    found.sort(key=lambda item: item[1].chi_square)
    where, best = _simplest(found, limits)
    drop = before - best.chi_square
    # an equation a little off leaves as much, of any shape
    if drop < max(limits.gain, limits.equation * first.gain):
        return None
    if drop < limits.second * max(first.gain, 0.0) and _cosine(where, best) > limits.second_cosine:
        return None
    # splines leave a part of a quick course, which something that goes on and off takes up
    if best.courses and any(h.switches for h in best.hypotheses) and drop < limits.beside_course * first.gain:
        return None
    rivals = {frozenset(joint.keys): joint for _, joint in reversed(found)}
    ranked = sorted(rivals.values(), key=lambda e: e.chi_square)
    return option_of(nominal, problem, best, ranked, limits, tick=tick)


def _untried(
    joints: Sequence[Explanation], count: int, limits: Limits
) -> dict[str, tuple[list[Hypothesis], list[dict[str, float]]]]:
    """Each effect of the best of these pairs and of those that nearly reach it, alone: key -> hypothesis and values."""
    lowest = joints[0].chi_square if joints else 0.0
    near = [
        j for j in joints if j.chi_square < lowest + limits.nearly * max(lowest - count, 0.0) + limits.rival
    ]
    alone: dict[str, tuple[list[Hypothesis], list[dict[str, float]]]] = {}
    for joint in near:
        for key, hypothesis, values in zip(joint.keys, joint.hypotheses, joint.values, strict=True):
            alone.setdefault(key, ([hypothesis], [values]))
    return alone


def _joined(
    about: LinearisedProblem,
    first: Explanation,
    candidates: Sequence[Hypothesis],
    limits: Limits,
    tick: Tick,
) -> list[Explanation]:
    """Refit the most promising partners of an effect together with it, best first.

    Partners are scored by what neither the nuisance model nor other values of the first effect could explain.
    """
    residual = about.residual - first.deviation
    left = about.apply_inverse_covariance(residual)
    others = [windowed(about, h, left) for h in candidates if h.key not in first.keys]
    free = [FREE * first.tangent, *([] if about.nuisance.courses is None else [about.nuisance.courses])]
    nuisance = replace(about.nuisance, courses=np.hstack(free))
    scores = score(replace(about, nuisance=nuisance), others, residual, tick=tick)
    promising = [s for s in scores if s.gain > max(limits.gain, limits.partner * scores[0].gain)][:PARTNERS]

    def refitted(s: Score) -> Explanation:
        start = switched(about, s.hypothesis, s.start, residual, tick=tick)
        both, values = [*first.hypotheses, s.hypothesis], [*first.values, start]
        return fit_jointly(about, both, values, limits, iterations=BRIEF_BESIDE, tick=tick)

    joints = parallel_map(refitted, promising)
    lowest = min((joint.chi_square for joint in joints), default=0.0)
    halfway = 0.5 * (about.chi_square(residual) + lowest)

    def finished(joint: Explanation) -> Explanation:
        if joint.chi_square > halfway:  # those that may be the answer, or its rivals, to the end
            return joint
        joint = fit_jointly(about, joint.hypotheses, joint.values, limits, iterations=8, tick=tick)
        # scores do not see what happens between samples, which is what the alternatives differ by
        return either_way(about, joint, limits, tick=tick) if joint.hypotheses[-1].choices else joint

    joints = parallel_map(finished, joints)
    return sorted((j for j in joints if not j.at_bound), key=lambda e: e.chi_square)


def _simplest(
    found: Sequence[tuple[LinearisedProblem, Explanation]], limits: Limits
) -> tuple[LinearisedProblem, Explanation]:
    """The pair with the fewest parameters of those that fit as well as the first, within what no pair explains or they cost."""
    about, first = found[0]
    close = first.chi_square + limits.rival + limits.tie * max(first.chi_square - about.count, 0.0)
    cheap = cost(first, about, limits)
    near = [
        (there, joint)
        for there, joint in found
        if joint.chi_square <= close or cost(joint, there, limits) <= cheap
    ]
    return min(near, key=lambda item: (len(item[1].coordinates), item[1].chi_square))


def _cosine(about: LinearisedProblem, joint: Explanation) -> float:
    """Absolute cosine between what the last effect does and what those before it do, the nuisance model taken out."""
    old = trace(about)
    new = about.deviation(joint.hypotheses[-1].effects(joint.values[-1]))
    size = about.chi_square(old) * about.chi_square(new)
    return float(abs(old @ about.apply_inverse_covariance(new)) / np.sqrt(size)) if size > 0 else 1.0
