"""What a refit of the nominal device takes up by itself: of an effect that was there in the calibration, too, it is not told."""

from __future__ import annotations

from dataclasses import replace

from vo2_models.diagnosis.hypotheses import Hypothesis
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.problem import LinearisedProblem

__all__ = ["without_absorbed"]


def without_absorbed(problem: LinearisedProblem, hypothesis: Hypothesis, limits: Limits) -> Hypothesis:
    """Return the hypothesis without those magnitudes beside its first that the refitted nominal device takes up.

    The steady gain that comes with a late part, for instance, is the height of a loop that is fitted anew: left free it
    trades with that height until it comes to a bound, and takes what can be told along.

    Parameters
    ----------
    problem : with the nominal device fitted anew
    hypothesis : as `hypotheses` made it
    limits : with what counts as all of it
    """
    names = hypothesis.magnitudes[1:]
    start = dict(hypothesis.starts[0])
    gone = []
    for name in names:
        size = start[name] or hypothesis.scales[name]
        # beside the first: one may mean nothing without it
        with_it, without = ({**start, name: value} for value in (size, 0.0))
        columns = problem.deviations([hypothesis.effects(with_it), hypothesis.effects(without)])
        change = columns[0] - columns[1]
        if problem.chi_square(change) <= limits.absorbed * float(change @ change):
            gone.append(name)
    if not gone:
        return hypothesis
    starts = tuple({n: v for n, v in start.items() if n not in gone} for start in hypothesis.starts)
    unique = tuple({tuple(start.items()): start for start in starts}.values())
    return replace(
        hypothesis, starts=unique, scales={n: v for n, v in hypothesis.scales.items() if n not in gone}
    )
