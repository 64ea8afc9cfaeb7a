"""Effects whose amplitude may take any slow course in time: a drift is a class of forms, its straight line one member.

What such an effect makes of a recording is, while it is small, a pattern times its amplitude f(t). The straight line
f = rate t is fitted as every other parameter; what bends about it is a sum of splines whose weights belong to the nuisance
model, so that a refit of them is in every chi-square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.hypotheses import MAGNITUDE_STEP, Hypothesis
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.identification.enrichment import cubic_spline

__all__ = ["course_columns", "gain_of_course", "knots_of", "with_courses"]

Floats = NDArray[np.float64]
KNOTS = 24
"""Splines over a recording: what swings more than some eight times in it is no slow course."""
FEWEST, MOST = 6, 96
"""Least splines of a recording, and most of all together where there are several."""


def knots_of(problem: LinearisedProblem) -> int:
    """Return the number of splines over each recording.

    Parameters
    ----------
    problem : tells how many recordings there are
    """
    return int(np.clip(MOST // len(problem.parts), FEWEST, KNOTS))


def with_courses(problem: LinearisedProblem, hypotheses: Sequence[Hypothesis]) -> LinearisedProblem:
    """Return the same problem, in whose nuisance model these effects may bend in time.

    Parameters
    ----------
    problem : without courses
    hypotheses : of records with a `course`, a parameter whose product with the time is the amplitude
    """
    if not hypotheses:
        return problem
    columns = np.hstack([course_columns(problem, hypothesis)[:, 1:] for hypothesis in hypotheses])
    return replace(
        problem,
        nuisance=replace(problem.nuisance, courses=columns),
        courses=tuple(hypothesis.key for hypothesis in hypotheses),
    )


def course_columns(problem: LinearisedProblem, hypothesis: Hypothesis) -> Floats:
    """Return whitened columns of one effect (N, 1 + c): its straight line, then random walks from spline to spline without it.

    A unit of a walk is a step as large as typical magnitudes make over the recording.

    Parameters
    ----------
    problem : whose nuisance model is to take the course
    hypothesis : of a record with a `course`
    """
    name = hypothesis.record.course
    typical = {n: 0.0 if n in hypothesis.magnitudes else v for n, v in hypothesis.starts[0].items()}
    typical[name] = hypothesis.scales[name]
    plain = replace(problem, included={k: v for k, v in problem.included.items() if k != hypothesis.key})
    line = plain.stack(plain.responses(hypothesis.effects(typical)), plain.responses({})) / MAGNITUDE_STEP
    count = knots_of(problem)
    knots = np.asarray((np.arange(count) - 1.0) / (count - 3.0), dtype=np.float64)
    walks = np.zeros((line.size, count * len(problem.parts)))
    for row, part, _ in problem.iterate():
        past = (np.arange(part.size) + 1.0) / part.size
        course = cubic_spline(knots, past) @ np.tril(np.ones((count, count)))
        own = slice(count * row.part, count * (row.part + 1))
        walks[row.where, own] = (line[row.where] / past)[:, None] * course
    share = line @ walks / max(float(line @ line), 1e-300)
    return np.column_stack([line, walks - np.outer(line, share)])


def gain_of_course(problem: LinearisedProblem, columns: Floats, left: Floats) -> float:
    """Return the drop of chi-square by the columns of a course.

    Parameters
    ----------
    problem : with its nuisance model
    columns : (N, 1 + c), as `course_columns` returns them
    left : (N,) what the nuisance model leaves of the residual
    """
    gram = columns.T @ problem.apply_inverse_covariance(columns)
    gram[np.diag_indices_from(gram)] += 1.0
    along = left @ columns
    return float(along @ np.linalg.solve(gram, along))
