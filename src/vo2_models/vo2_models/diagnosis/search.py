"""Third stage: every effect of the catalogue tried, the promising ones refitted alone and in pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vo2_models.device.coefficients import HUGE
from vo2_models.diagnosis.absorbed import without_absorbed
from vo2_models.diagnosis.adequacy import farthest_over_misfit, where_told
from vo2_models.diagnosis.courses import bent_by, with_courses, worth_their_price
from vo2_models.diagnosis.drift import Drift, drift_of
from vo2_models.diagnosis.explain import (
    BRIEF,
    Explanation,
    Score,
    cost,
    either_way,
    fit_jointly,
    price,
    score,
    switched,
)
from vo2_models.diagnosis.hypotheses import Hypothesis, hypotheses
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.locate import Located
from vo2_models.diagnosis.pairs import Option, option_of, pair_of, refit_about
from vo2_models.diagnosis.problem import LinearisedProblem, linearise_problem
from vo2_models.diagnosis.progress import Clock
from vo2_models.numerics.parallel import parallel_map

__all__ = ["Held", "Search", "search"]

SHORTLIST = 6
"""Hypotheses that are refitted in full."""
TRIMMED = 2
"""Refits to the samples that an effect explains best."""
RELINEARISED = 3
"""Explanations that are linearised about themselves, where constants may stand for them or another effect is as good."""


@dataclass(frozen=True)
class Held:
    """An effect in the place of constants that have moved: with it every constant is where the calibration left it.

    Attributes
    ----------
    option : the effect, its rivals those with constants held as well
    reference : the problem without effects, constants held; gains are told against it
    drift : how far which constants would have moved in its place
    ahead : by how much it is ahead of them, in chi-square, each constant and each parameter at the price of `explain.cost`
    """

    option: Option
    reference: LinearisedProblem
    drift: Drift
    ahead: float


@dataclass(frozen=True)
class Search:
    """What was tried, and what may be the answer.

    Attributes
    ----------
    candidates : every hypothesis that can show in these channels
    scores : all hypotheses by promise
    singles : refitted single explanations, best first
    options : what may be the answer, best first: two effects, one effect
    hidden : whether the nuisance model moved so far that it may hide an effect
    not_excited : ids of effects that these recordings would not show
    held : an effect in the place of moved constants, None where these are as good
    beyond : key -> largest distance of a channel, over the device's own misfit, that a single explanation leaves; of those that
        were linearised about themselves on a device without body, empty with one
    """

    candidates: tuple[Hypothesis, ...]
    scores: tuple[Score, ...]
    singles: tuple[Explanation, ...]
    options: tuple[Option, ...]
    hidden: bool
    not_excited: tuple[str, ...]
    held: Held | None = None
    beyond: Mapping[str, float] = field(default_factory=dict)


def search(
    located: Located, limits: Limits, clock: Clock, *, one_loop: bool, first_use: bool = False
) -> Search:
    """Score all hypotheses, refit the promising ones, and look for a second effect beside the best.

    Where the constants had to move far to absorb a mismatch, they may have absorbed an effect: hypotheses are then tried
    with constants as the calibration left them as well, and the better of both counts. One that explains by itself what
    several constants together do not explain better is an option in their place.

    Parameters
    ----------
    located : the problem without effects
    limits : when something counts
    clock : told what is being done
    one_loop : whether many effects look alike in these recordings, so that more of them are refitted
    first_use : whether the nominal device is refitted to all recordings; then the calibration fixes no constant

    Returns
    -------
    hypotheses with their scores, refitted explanations, best first, and what was not excited
    """
    problem = located.problem
    hidden = drift_of(problem, problem.residual).significant(limits.drift_p)
    if located.within_misfit(limits.own_misfit) and not hidden:
        return Search((), (), (), (), False, ())
    candidates = hypotheses(problem, located.nominal.device, located.remaining)
    if first_use:
        candidates = [without_absorbed(problem, hypothesis, limits) for hypothesis in candidates]
    clock.expected = 2 * sum(len(h.starts) for h in candidates) + 40 * SHORTLIST + 200
    clock.say(f"trying {len(candidates)} effects")
    shortlist = 2 * SHORTLIST if one_loop else SHORTLIST
    scores = score(problem, candidates, problem.residual, tick=clock.tick)
    if located.within_misfit(
        limits.own_misfit
    ):  # with constants moved; what is left is the law's, and a lag or a delay makes up for it
        return Search(tuple(candidates), tuple(scores), (), (), hidden, tuple(_not_excited(scores, limits)))
    clock.say("refitting the most promising")
    fits = _refitted(problem, scores, limits, shortlist, clock)
    fixed, unmoved = problem, list[Explanation]()
    if hidden and not first_use and not _without_constants(located, fits, limits, clock):
        fixed, unmoved = _with_fixed_constants(located, candidates, fits, limits, shortlist, clock)
        fits += unmoved
    courses = _with_courses(located, candidates, fits, limits, clock)
    if any(fit.hypotheses[0].record.takes_course for fit in courses):
        fits += _beside_courses(located, fits, courses, limits, clock)
    fits += courses
    before = problem.residual_chi_square
    best: dict[str, Explanation] = {}
    for fit in sorted(fits, key=lambda e: cost(e, problem, limits)):
        best.setdefault(fit.keys[0], replace(fit, gain=before - fit.chi_square))
    singles = sorted(best.values(), key=lambda e: cost(e, problem, limits))
    beyond: dict[str, float] = {}
    if located.own_misfit:
        singles, beyond = _about_themselves(located, singles, limits, clock)
    options = _options(located, singles, candidates, limits, clock)
    return Search(
        tuple(candidates), tuple(scores), tuple(singles), tuple(options), hidden,
        tuple(_not_excited(scores, limits)),
        None if one_loop else _in_place_of_constants(located, fixed, unmoved, limits, clock),
        beyond,
    )  # fmt: skip


def _without_constants(located: Located, fits: Sequence[Explanation], limits: Limits, clock: Clock) -> bool:
    """Whether an effect leaves nothing to constants: noise alone beside it, none of them moved, and far more without it."""
    problem = located.problem
    first = _best_inside(sorted(fits, key=lambda e: cost(e, problem, limits)), limits)
    without = problem.residual_chi_square / problem.count - 1.0
    if (
        first is None
        or first.at_bound
        or without < limits.loud
        or first.chi_square / problem.count - 1.0 > limits.part_of_loud * without
    ):
        return False
    option = option_of(located.nominal, problem, first, (), limits, tick=clock.tick)
    drift = drift_of(option.final, option.final.residual - option.chosen.deviation)
    return option.remaining < limits.least and not drift.significant(limits.drift_p)


def _about_themselves(
    located: Located, singles: Sequence[Explanation], limits: Limits, clock: Clock
) -> tuple[list[Explanation], dict[str, float]]:
    """Those that may be the answer or its rivals linearised about themselves, best first, and how far each leaves a channel.

    On a device without body constants that stood for an effect are far from where they belong beside it, and an effect fitted
    with constants held misses what these have done besides: neither says how well it fits.
    """

    def about(explanation: Explanation) -> tuple[Explanation, float]:
        one = option_of(located.nominal, located.problem, explanation, (), limits, tick=clock.tick)
        return one.chosen, farthest_over_misfit(one)

    near = [e for e in singles if e.gain >= limits.dominated * singles[0].gain]
    clock.say("linearising about each explanation")
    again = parallel_map(about, near)
    rest = [e for e in singles if e.gain < limits.dominated * singles[0].gain]
    order = sorted([*(e for e, _ in again), *rest], key=lambda e: cost(e, located.problem, limits))
    return order, {e.keys[0]: distance for e, distance in again}


def _with_courses(
    located: Located,
    candidates: Sequence[Hypothesis],
    fits: Sequence[Explanation],
    limits: Limits,
    clock: Clock,
) -> list[Explanation]:
    """Refits of effects that may take any course in time, where that could be worth a name."""
    problem = located.problem
    left = problem.apply_inverse_covariance(problem.residual)
    most = max((fit.gain for fit in fits), default=0.0)
    straight = {fit.keys[0]: fit for fit in fits}
    # some were fitted with constants held, and their gain is told against that
    drop = max((problem.residual_chi_square - fit.chi_square for fit in fits), default=0.0)
    nearest = {fit.keys[0]: fit for fit in sorted(fits, key=lambda e: -e.chi_square)}
    found = []
    for hypothesis in candidates:
        if not hypothesis.record.course:
            continue
        clock.tick()
        followed = hypothesis.record.takes_course
        known = (nearest if followed else straight).get(hypothesis.key)
        alone = 0.0
        if followed:  # the pattern is not linear as far as the course goes: what is left may all be its bend
            each = len(problem.parts) * price(problem, limits)
            knots, gain = worth_their_price(problem, hypothesis, left, each)
            alone = problem.residual_chi_square - known.chi_square if known else 0.0
            # at first use the misfit that counts as noise may be the effect's own
            most_by_bend = max(problem.residual_chi_square - alone - problem.count, gain - alone)
            gain, least = max(gain, alone), limits.course * drop
            worth = limits.gain + knots * each
        else:
            knots, gain = worth_their_price(problem, hypothesis, left, 0.0)
            least, most_by_bend = limits.course * most, gain - (known.gain if known else 0.0)
            worth = limits.gain + limits.bend * gain
        if gain < max(least, limits.gain) or most_by_bend < worth:
            continue
        bent = with_courses(problem, [hypothesis], knots=knots)
        kept = {n: v for n, v in hypothesis.starts[0].items() if n not in hypothesis.magnitudes}
        name = hypothesis.record.course  # beside any course no other power of the time
        start = {**kept, name: known.values[0].get(name, 0.0) if known else 0.0}
        fit = fit_jointly(bent, [hypothesis], [start], limits, iterations=BRIEF, tick=clock.tick)
        if followed:
            there, fit = refit_about(located.nominal, problem, fit, limits, tick=clock.tick)
            if problem.residual_chi_square - fit.chi_square < alone + worth:
                continue
            beyond = bent_by(there, there.residual - fit.deviation)
            change = replace(problem, courses=beyond).deviation(fit.effects, fit.shift)
        else:
            change = fit.deviation + bent.nuisance.of_courses(
                bent.fit_nuisance(bent.residual - fit.deviation)
            )
        found.append(replace(fit, gain=problem.residual_chi_square - fit.chi_square, deviation=change))
    return found


def _beside_courses(
    located: Located,
    fits: Sequence[Explanation],
    courses: Sequence[Explanation],
    limits: Limits,
    clock: Clock,
) -> list[Explanation]:
    """The best of the others, linearised about themselves as a course is that was simulated: like is compared with like."""
    problem = located.problem
    drop = problem.residual_chi_square - min(fit.chi_square for fit in courses)
    nearest = {fit.keys[0]: fit for fit in sorted(fits, key=lambda e: -e.chi_square)}
    near = [
        fit
        for fit in sorted(nearest.values(), key=lambda e: e.chi_square)
        if problem.residual_chi_square - fit.chi_square > limits.like_a_course * drop
        and not any(fit.keys == course.keys for course in courses)
    ][:RELINEARISED]
    return parallel_map(
        lambda fit: refit_about(located.nominal, problem, fit, limits, tick=clock.tick)[1], near
    )


def _refitted(
    problem: LinearisedProblem,
    scores: Sequence[Score],
    limits: Limits,
    shortlist: int,
    clock: Clock,
    known: Sequence[Explanation] = (),
) -> list[Explanation]:
    """Refit the most promising hypotheses, but those `known` already; those that may be the answer, or its rivals, to the end."""
    promising = [s for s in scores if s.gain > max(limits.promising * scores[0].gain, limits.faint)]
    # a limit of the drive is not linear: its score may be a quarter of that of others which it leaves far behind once refitted
    promising = [
        s for k, s in enumerate(promising) if k < shortlist or s.gain > limits.strong * scores[0].gain
    ]

    def briefly(s: Score) -> Explanation:
        start = switched(problem, s.hypothesis, s.start, problem.residual, tick=clock.tick)
        fit = fit_jointly(problem, [s.hypothesis], [start], limits, iterations=BRIEF, tick=clock.tick)
        # scores do not see what happens between samples, which is what the alternatives differ by
        return either_way(problem, fit, limits, tick=clock.tick) if s.hypothesis.choices else fit

    there = {fit.keys[0] for fit in known}
    fits = [*known, *parallel_map(briefly, [s for s in promising if s.hypothesis.key not in there])]
    most = max((fit.gain for fit in fits), default=0.0)

    def finished(fit: Explanation) -> Explanation:
        if fit.gain <= limits.to_the_end * most:
            return fit
        again = fit_jointly(problem, fit.hypotheses, fit.values, limits, tick=clock.tick)
        return either_way(problem, min(fit, again, key=lambda e: e.chi_square), limits, tick=clock.tick)

    return parallel_map(finished, fits)


def _with_fixed_constants(
    located: Located,
    candidates: Sequence[Hypothesis],
    moved: Sequence[Explanation],
    limits: Limits,
    shortlist: int,
    clock: Clock,
) -> tuple[LinearisedProblem, list[Explanation]]:
    """The problem with constants as the calibration left them, and refits: what is an effect then is no drift that resembles it.

    Constants that follow an effect are far from where they were, and the simulation is not linear that far: scores do not see a
    small effect there, so that what was fitted with `moved` constants begins anew from its values, and the best fits are
    linearised about themselves once more.
    """
    problem = located.problem
    fixed = linearise_problem(
        located.nominal,
        problem.parts,
        constants=[c for c in problem.constants if not c.held],
        shapes=problem.shapes,
        loops=problem.loops,
        say=clock.say,
    )
    known = parallel_map(
        lambda fit: fit_jointly(fixed, fit.hypotheses, fit.values, limits, iterations=BRIEF, tick=clock.tick),
        moved,
    )
    scores = score(fixed, candidates, fixed.residual, tick=clock.tick)
    fits = sorted(_refitted(fixed, scores, limits, shortlist, clock, known), key=lambda e: e.chi_square)
    least = fits[0].chi_square / fixed.count - 1.0 if fits else 0.0
    near = [e for e in fits if e.chi_square / fixed.count - 1.0 <= limits.near * max(least, limits.least)][
        :RELINEARISED
    ]

    def again(fit: Explanation) -> Explanation:
        return refit_about(located.nominal, fixed, fit, limits, tick=clock.tick)[1]

    return fixed, [*parallel_map(again, near), *fits[len(near) :]]


def _in_place_of_constants(
    located: Located,
    fixed: LinearisedProblem,
    unmoved: Sequence[Explanation],
    limits: Limits,
    clock: Clock,
) -> Held | None:
    """The effect that explains, with no constant moved, what several of them together explain no better.

    Constants are many, and make up for nearly every effect by moves that fit it and nothing else. On another day a room, a
    time constant and a zero move each as they will: a single effect that does the same would be a coincidence.
    On a device without body zero and gain are all that moves, and they do mimic effects: there it is not asked, nor on one loop.
    """
    first = _best_inside(sorted(unmoved, key=lambda e: cost(e, fixed, limits)), limits)
    if first is None or first.at_bound or not located.nominal.model.description.has_body:
        return None
    problem = located.problem
    drift = drift_of(problem, problem.residual)
    moved = max(int(np.count_nonzero(drift.sigmas > limits.constant_moved)), 1)
    constants = problem.residual_chi_square + moved * price(problem, limits)

    def ahead(explanation: Explanation, count: int) -> float:
        excess = max(explanation.chi_square / count - 1.0, 0.0)
        return constants - cost(explanation, fixed, limits) - limits.rival * (1.0 + excess)

    if ahead(first, fixed.count) <= 0.0:
        return None
    clock.say("judging an effect in the place of moved constants")
    option = option_of(located.nominal, fixed, first, unmoved, limits, tick=clock.tick)
    if option.chosen.at_bound or ahead(option.chosen, option.final.count) <= 0.0:
        return None
    return Held(option, fixed, drift, constants - cost(option.chosen, fixed, limits))


def _options(
    located: Located,
    singles: Sequence[Explanation],
    candidates: Sequence[Hypothesis],
    limits: Limits,
    clock: Clock,
) -> list[Option]:
    """What could be the answer, best first: two effects, one effect."""
    problem = located.problem
    first = _best_inside(singles, limits)
    if first is None or first.gain <= limits.gain:
        return []
    clock.say("linearising about the explanation")
    alone = option_of(located.nominal, problem, first, singles, limits, tick=clock.tick)
    # a gain that holds only where the simulation is linear is gone there: then another effect may be ahead
    courses = [alone]
    for other in [e for e in singles if e is not first and not e.at_bound][: RELINEARISED - 1]:
        # nor does the linear gain of a large course say much beside that of another
        rival_course = _takes_course(other) and _takes_course(first)
        if other.gain <= alone.chosen.gain and not rival_course:
            continue
        again = option_of(located.nominal, problem, other, singles, limits, tick=clock.tick)
        courses += [again] if rival_course else []
        # one that went to its bound would not be named
        if not again.chosen.at_bound and cost(again.chosen, problem, limits) < cost(
            alone.chosen, problem, limits
        ):
            alone = again
    rivals = [one for one in courses if one is not alone] if len(courses) > 1 else []
    alone = _in_one_switch(located, alone, limits, clock)
    if located.own_misfit:  # beside a misfit that is no noise a second effect is never named
        return [_where_told(located, alone, limits, clock)]
    clock.say("looking for a second effect")
    pair = pair_of(located.nominal, problem, alone, candidates, limits, tick=clock.tick)
    if pair is None and first.cornered:
        pair = _pair_in_place_of_one(located, alone, singles, candidates, limits, clock)
    if not pair:
        return [alone]
    if pair.remaining > limits.slack:  # a large course is not told from another before its partner is there
        for rival in rivals:
            swapped = pair_of(located.nominal, problem, rival, candidates, limits, tick=clock.tick)
            if swapped is not None and cost(swapped.chosen, problem, limits) < cost(
                pair.chosen, problem, limits
            ):
                pair, alone = swapped, rival
    one = _late_for_one_reason(located, pair, singles, limits, clock)
    if one is not None:
        return [one]
    return [pair, *_partner_alone(located, pair, alone, limits, clock), alone]


def _late_for_one_reason(
    located: Located, pair: Option, singles: Sequence[Explanation], limits: Limits, clock: Clock
) -> Option | None:
    """The effect that is late for the reason that two seem to be: on one sensor, or by the same time on every response.

    A sensor that averages is late and slow, and no clock is off besides; two sensors that are as slow as each other follow
    something that is. Of the effects that may be the reason, the one that costs least about itself; None if it is no such pair.
    """
    two = pair.chosen.hypotheses
    signals = {one.signal for one in two}
    if not all(one.signal and one.record.between_samples for one in two):
        return None
    if len(signals) == 1:
        reasons = [
            e for e in singles if (h := e.hypotheses[0]).signal in signals and h.record.between_samples
        ]
    else:
        times = [
            values[h.record.parameters[0].name] for h, values in zip(two, pair.chosen.values, strict=True)
        ]
        responses = {response.role for response in located.nominal.model.description.responses}
        if signals != responses or max(times) > limits.as_late * min(times):
            return None
        least = limits.dominated * singles[0].gain
        reasons = [e for e in singles if not e.hypotheses[0].signal and e.gain >= least and not e.at_bound]
    if not reasons:
        return None
    clock.say("looking for one reason to be late")
    told = [
        option_of(located.nominal, located.problem, one, singles, limits, tick=clock.tick)
        for one in reasons[:RELINEARISED]
    ]
    return min(told, key=lambda one: cost(one.chosen, located.problem, limits))


def _takes_course(explanation: Explanation) -> bool:
    """Whether the simulation follows the course of a single effect."""
    return bool(explanation.courses) and explanation.hypotheses[0].record.takes_course


def _where_told(located: Located, alone: Option, limits: Limits, clock: Clock) -> Option:
    """The same effect fitted to the samples that it explains best, where it leaves more than the device's own misfit.

    Least squares take a place that the law misses by ten times its misfit for a hundred others.
    """
    final, chosen = alone.final, alone.chosen
    if farthest_over_misfit(alone) <= limits.own_misfit:
        return alone
    for _ in range(TRIMMED):
        kept = where_told(final, final.residual - chosen.deviation, limits.told)
        fit = fit_jointly(
            final.restricted(kept),
            chosen.hypotheses,
            chosen.values,
            limits,
            iterations=BRIEF,
            tick=clock.tick,
        )
        chosen = replace(fit, deviation=final.deviation(fit.effects, fit.shift), courses=chosen.courses)
    chi_square = final.chi_square(final.residual - chosen.deviation)
    chosen = replace(chosen, chi_square=chi_square, gain=located.problem.residual_chi_square - chi_square)
    return replace(alone, chosen=chosen, remaining=chi_square / final.count - 1.0)


def _partner_alone(
    located: Located, pair: Option, alone: Option, limits: Limits, clock: Clock
) -> list[Option]:
    """The second effect of a pair by itself, where it fits better than the first: one that was found beside it only."""
    chosen = pair.chosen
    place = next(k for k, key in enumerate(chosen.keys) if key not in alone.chosen.keys)
    partner = fit_jointly(
        located.problem, [chosen.hypotheses[place]], [chosen.values[place]], limits, tick=clock.tick
    )
    if partner.chi_square > alone.chosen.chi_square or partner.at_bound:
        return []
    return [option_of(located.nominal, located.problem, partner, alone.rivals, limits, tick=clock.tick)]


def _in_one_switch(located: Located, alone: Option, limits: Limits, clock: Clock) -> Option:
    """The same effect gone on for good where it was taken to go off, if that fits as well.

    What heats from the beginning and goes off differs from what goes on then by the temperature of the room, and that may
    be another one every day: of the two, the one with a switch less, the room as the calibration left it.
    """
    problem = located.problem
    hypothesis, values = alone.chosen.hypotheses[0], alone.chosen.values[0]
    if not all(abs(values.get(name, HUGE)) < HUGE for name in hypothesis.switches or ("",)):
        return alone
    on, off = hypothesis.switches
    once = {n: -v if n in hypothesis.magnitudes else v for n, v in values.items() if n != off}
    turned = replace(
        alone.chosen,
        values=({**once, on: values[off]},),
        coordinates=tuple(place for place in alone.chosen.coordinates if place[1] != off),
        shift=np.where([c.name == "thermal.ambient" for c in problem.constants], 0.0, alone.chosen.shift),
    )
    again = option_of(located.nominal, problem, turned, alone.rivals, limits, tick=clock.tick)
    return again if again.chosen.chi_square < alone.chosen.chi_square + limits.rival else alone


def _pair_in_place_of_one(
    located: Located,
    alone: Option,
    singles: Sequence[Explanation],
    candidates: Sequence[Hypothesis],
    limits: Limits,
    clock: Clock,
) -> Option | None:
    """Two effects that fit better than one which had to go as far as is physical: it may stand for both of them.

    They begin with the best single effect that keeps away from its bounds, and may resemble each other: both must beat
    what resembles them.
    """
    inside = next((e for e in singles if not e.cornered), None)
    if inside is None or inside.gain <= limits.gain:
        return None
    clock.say("looking for two effects in the place of one")
    other = option_of(located.nominal, located.problem, inside, singles, limits, tick=clock.tick)
    alike = replace(limits, second_cosine=1.0)
    pair = pair_of(located.nominal, located.problem, other, candidates, alike, tick=clock.tick)
    better = pair is not None and pair.chosen.chi_square < alone.chosen.chi_square - limits.rival
    return pair if better else None


def _best_inside(explanations: Sequence[Explanation], limits: Limits) -> Explanation | None:
    """The best that does not end at a physical bound, unless one that does is better by far."""
    if not explanations:
        return None
    inside = [e for e in explanations if not e.at_bound]
    if inside and inside[0].gain > limits.inside * explanations[0].gain:
        return inside[0]
    return explanations[0]


def _not_excited(scores: Sequence[Score], limits: Limits) -> list[str]:
    """Effects that a clearly visible magnitude would not show in these recordings."""
    seen: dict[str, float] = {}
    for s in scores:
        seen[s.hypothesis.record.id] = max(seen.get(s.hypothesis.record.id, 0.0), s.visible)
    return [name for name, chi_square in seen.items() if chi_square < limits.unseen]
