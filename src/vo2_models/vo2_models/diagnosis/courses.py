"""Effects whose amplitude may take any slow course in time: a drift is a class of forms, its straight line one member.

What such an effect makes of a recording is, while it is small, a pattern times its amplitude f(t). The straight line
f = rate t is fitted as every other parameter; what bends about it is a sum of splines whose weights belong to the nuisance
model, so that a refit of them is in every chi-square. A room that swings by a kelvin moves loops that are a few kelvins wide:
where the effect's hooks take the course, the simulation follows the bend that was found, and what is nuisance is linear about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.bend import Bend, walks_of
from vo2_models.diagnosis.hypotheses import MAGNITUDE_STEP, Hypothesis
from vo2_models.diagnosis.problem import LinearisedProblem

__all__ = [
    "bent_by",
    "constants_like",
    "course_columns",
    "gain_of_course",
    "knots_of",
    "with_courses",
    "worth_their_price",
]

Floats = NDArray[np.float64]
KNOTS = 24
"""Splines over a recording: what swings more than some eight times in it is no slow course."""
STARTS = 20.0
"""Standard deviation of where a course begins that the simulation follows, in steps that matter."""
SAME = 0.999
"""Cosine of two changes of the recording above which they are one."""
FEWEST, MOST = 6, 96
"""Least splines of a recording, and most of all together where there are several."""
SMOOTH = (4, 8)
"""Splines of a course that hardly bends: of several recordings each one's own line would cost 48 to 96 splines else."""


def knots_of(problem: LinearisedProblem) -> tuple[int, ...]:
    """Return the numbers of splines over each recording that may be tried, the largest first.

    Parameters
    ----------
    problem : tells how many recordings there are
    """
    most = int(np.clip(MOST // len(problem.parts), FEWEST, KNOTS))
    return (most,) if len(problem.parts) == 1 else (most, *(count for count in SMOOTH if count < most))


def with_courses(
    problem: LinearisedProblem,
    hypotheses: Sequence[Hypothesis],
    held: Sequence[int] = (),
    *,
    knots: int | None = None,
) -> LinearisedProblem:
    """Return the same problem, in whose nuisance model these effects may bend in time.

    Parameters
    ----------
    problem : without the columns of courses
    hypotheses : of records with a `course`, a parameter whose product with the time is the amplitude
    held : places of constants that do not move, see `constants_like`
    knots : splines over each recording, those that the problem's courses have already or the most by default
    """
    if not hypotheses:
        return problem
    thermal = problem.nuisance.thermal.copy()
    thermal[:, list(held)] = 0.0
    found = [course_columns(problem, hypothesis, knots) for hypothesis in hypotheses]
    columns = np.hstack([walks for _, walks, _ in found])
    bends = {h.key: bend for h, (_, _, bend) in zip(hypotheses, found, strict=True)}
    bent = np.zeros(problem.residual.size)
    for _, walks, bend in found:
        if bend.weights.size:
            bent += walks @ bend.weights.ravel()
    return replace(
        problem,
        nuisance=replace(problem.nuisance, courses=columns, thermal=thermal),
        courses=bends,
        residual=problem.residual + bent,
        bent=bent,
    )


def bent_by(problem: LinearisedProblem, vector: Floats) -> dict[str, Bend]:
    """Return how the effects bend in time that the nuisance model absorbs of a whitened residual (N,) with.

    Parameters
    ----------
    problem : with courses, or without: then there is nothing to bend
    vector : what is left once the effects are simulated as the problem has them
    """
    if problem.nuisance.courses is None:
        return dict(problem.courses)
    weights = problem.nuisance.course_weights(problem.fit_nuisance(vector))
    each = np.split(weights, max(len(problem.courses), 1))
    return {key: bend.by(own) for (key, bend), own in zip(problem.courses.items(), each, strict=True)}


def course_columns(
    problem: LinearisedProblem, hypothesis: Hypothesis, knots: int | None = None
) -> tuple[Floats, Floats, Bend]:
    """Return whitened columns of one effect, its straight line (N,) and random walks from spline to spline (N, c), and the bend.

    A unit of a walk is a step as large as typical magnitudes make over the recording. The straight line is taken off walks
    about no bend; about a bend the walks are as they were there.

    Parameters
    ----------
    problem : whose nuisance model is to take the course
    hypothesis : of a record with a `course`
    knots : splines over each recording; those that the problem's course has already, or the most, by default
    """
    key, name = hypothesis.key, hypothesis.record.course
    typical = {n: 0.0 if n in hypothesis.magnitudes else v for n, v in hypothesis.starts[0].items()}
    known = problem.courses.get(key)
    bent = known is not None and known.weights.size > 0 and key in problem.included
    if bent:
        here = {n: float(v) for n, v in problem.included[key].items() if n != "signal"}
        origin, before = problem, problem.nominal_responses
    else:
        here = typical
        origin = replace(
            problem, included={k: v for k, v in problem.included.items() if k != key}, courses={}
        )
        before = tuple(origin.responses({}))
    moved = hypothesis.effects({**here, name: here.get(name, 0.0) + hypothesis.scales[name]})
    line = origin.stack(origin.responses(moved), before) / MAGNITUDE_STEP
    # where it begins is nobody's knowledge: a constant of the device that does the same must not move for it
    followed = hypothesis.record.takes_course
    count = knots or (known.shares.shape[1] if bent and known is not None else knots_of(problem)[0])
    start = STARTS if followed else 1.0
    bend = Bend(hypothesis.scales[name] / MAGNITUDE_STEP, np.zeros((len(problem.parts), count)), start)
    if bent and known is not None:
        bend = known
    changed = line
    if followed:  # a constant acts from before the recording on: by simulation
        weights = bend.weights.copy() if bend.weights.size else np.zeros_like(bend.shares)
        weights[:, 0] += MAGNITUDE_STEP / start
        there = replace(origin, courses={key: replace(bend, weights=weights)})
        changed = there.stack(there.responses(hypothesis.effects(here)), before) / (MAGNITUDE_STEP / start)
    walks = np.zeros((line.size, bend.shares.size))
    for row, part, _ in problem.iterate():
        past = (np.arange(part.size) + 1.0) / part.size
        first = count * row.part
        walks[row.where, first : first + count] = (line[row.where] / past)[:, None] * walks_of(
            count, part.size, start
        )
        if followed:
            walks[row.where, first] = changed[row.where]
    if bent:
        return line, walks - np.outer(line, bend.shares), bend
    share = line @ walks / max(float(line @ line), 1e-300)
    return line, walks - np.outer(line, share), replace(bend, shares=share.reshape(bend.shares.shape))


def constants_like(problem: LinearisedProblem, hypothesis: Hypothesis) -> dict[int, float]:
    """Return the places of constants that do what a course does which is the same all the time.

    Parameters
    ----------
    problem : without courses
    hypothesis : of an effect whose course is followed

    Returns
    -------
    place -> weight of the course's first walk, in every recording, that does what a unit of the constant does
    """
    line, walks, bend = course_columns(problem, hypothesis)
    first = walks[:, :: bend.shares.shape[1]]
    offset = np.sum(first, axis=1) + float(np.sum(bend.shares[:, 0])) * line
    own = float(np.linalg.norm(offset))
    found = {}
    for place, column in enumerate(problem.nuisance.thermal.T):
        along, size = float(offset @ column), float(np.linalg.norm(column))
        if abs(along) > SAME * own * size:
            found[place] = along / own**2
    return found


def worth_their_price(
    problem: LinearisedProblem, hypothesis: Hypothesis, left: Floats, price: float
) -> tuple[int, float]:
    """Return how many splines over each recording are worth what they cost, and the drop of chi-square by them.

    Parameters
    ----------
    problem : without courses
    hypothesis : of a record with a `course`
    left : (N,) what the nuisance model leaves of the residual
    price : of one more spline over each recording, in chi-square; 0 for as many as there may be
    """
    tried = []
    for knots in knots_of(problem) if price else knots_of(problem)[:1]:
        line, walks, _ = course_columns(problem, hypothesis, knots)
        tried.append((knots, gain_of_course(problem, np.column_stack([line, walks]), left)))
    return max(tried, key=lambda one: one[1] - one[0] * price)


def gain_of_course(problem: LinearisedProblem, columns: Floats, left: Floats) -> float:
    """Return the drop of chi-square by the columns of a course.

    Parameters
    ----------
    problem : with its nuisance model
    columns : (N, 1 + c), the line and the walks that `course_columns` returns
    left : (N,) what the nuisance model leaves of the residual
    """
    gram = columns.T @ problem.apply_inverse_covariance(columns)
    gram[np.diag_indices_from(gram)] += 1.0
    along = left @ columns
    return float(along @ np.linalg.solve(gram, along))
