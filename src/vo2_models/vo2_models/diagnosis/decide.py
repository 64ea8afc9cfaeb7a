"""Fourth stage: which explanation is adequate, judged on held-out blocks; else what cannot be named."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import HUGE
from vo2_models.diagnosis.adequacy import (
    Adequacy,
    adequacy_of,
    behind_the_loop,
    ends_flat,
    farthest_over_misfit,
    reached,
)
from vo2_models.diagnosis.breakdown import Breakdown, breakdown
from vo2_models.diagnosis.drift import Drift, drift_of
from vo2_models.diagnosis.explain import Explanation, Score, score
from vo2_models.diagnosis.held_out import HeldOut, block_folds, held_out, recording_folds
from vo2_models.diagnosis.hypotheses import Hypothesis
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.locate import Located
from vo2_models.diagnosis.moved_alone import constants_leave, left_by, moved_alone
from vo2_models.diagnosis.next_experiment import by_hand, propose, without_explanation
from vo2_models.diagnosis.nonparametric_correction import (
    NonparametricCorrection,
    fit_nonparametric_correction,
)
from vo2_models.diagnosis.pairs import Option, option_of, trace
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.read import Reading
from vo2_models.diagnosis.result import NextExperiment
from vo2_models.diagnosis.search import Held, Search

__all__ = ["Decision", "decide", "told_as", "without_a_name"]

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
IN_ITS_PLACE = 3
"""Effects at most that are asked in the place of one that held-out blocks refute."""


@dataclass(frozen=True)
class Decision:
    """The answer with its evidence.

    Attributes
    ----------
    verdict : agrees; drifted, where moved constants are all; differs
    final : the problem about the best explanation (without effects where there is none)
    chosen : what is named, None for nothing
    judged : held-out quality of `chosen` (or of the nuisance model alone)
    rivals : explanations with one effect replaced, best first
    remaining_excess : excess power over noise power that the best option leaves
    unnamed : correction without a name, None where not needed
    breakdown : where a named effect acts, else where more than noise is left
    rival_pairs : named effect, rival that the recordings do not separate from it
    proposal : what to record next
    drift : how far the constants have moved beside what is named
    mimics : effects that would look like that move, best first; none where it is small
    adequacy : of what is named, else of the best option; None where there is no option
    unlike_noise : whether more than noise is left, which nothing predicts
    equivalent : keys of the effects of which it is one, best first, that of `chosen` among them, which stands for all; empty
        where a single effect is named. On a device without body those that explain as much as `chosen` does; elsewhere those
        that are together as likely as a name has to be, see `report.equally_likely`
    held : where what is named stands in the place of moved constants
    taken_up : channels that are that many times the calibration's held-out error from the model as it is, where moved constants
        and loops together take it up and none is told; empty elsewhere
    alone : moves of few constants that explain by themselves what differs, further than another day may move them, where nothing
        is named
    as_calibrated : channel that most of an excess is in, where it is left no further than parts of its calibration that the fit
        had left out; empty where that is not the reason of an agreement
    """

    verdict: Literal["agrees", "drifted", "differs"]
    final: LinearisedProblem
    chosen: Explanation | None
    judged: HeldOut
    rivals: tuple[Explanation, ...]
    remaining_excess: float
    unnamed: NonparametricCorrection | None
    breakdown: tuple[Breakdown, ...]
    rival_pairs: tuple[tuple[str, str], ...]
    proposal: NextExperiment | None
    drift: Drift
    mimics: tuple[Hypothesis, ...]
    adequacy: Adequacy | None = None
    unlike_noise: bool = False
    equivalent: tuple[str, ...] = ()
    held: Held | None = None
    taken_up: Mapping[str, float] = field(default_factory=dict)
    alone: Drift | None = None
    as_calibrated: str = ""


@dataclass(frozen=True)
class _Verdict:
    """The first option that is admissible, or the nuisance model alone.

    `shown` is the largest share of the excess that an option explains, admissible or not; `alone` what `moved_alone` finds, where
    nothing is named; `equivalent`, `held` as in `Decision`.
    """

    option: Option | None
    judged: HeldOut
    rivals: tuple[Explanation, ...]
    remaining: float
    adequacy: Adequacy | None
    shown: float
    equivalent: tuple[str, ...] = ()
    held: Held | None = None
    alone: Drift | None = None


def decide(located: Located, found: Search, reading: Reading, limits: Limits, clock: Clock) -> Decision:
    """Judge the options on held-out blocks; name the first that is adequate, else describe what has no name.

    Parameters
    ----------
    located : the problem without effects
    found : what the search has refitted
    reading : of the recordings
    limits : of the decisions
    clock : told what is being done

    Returns
    -------
    verdict, what is named and what might look the same
    """
    clock.say("judging on held-out blocks")
    folds = recording_folds(located.problem, reading.calibrations) or block_folds(located.problem)
    verdict = _judged(located, found, folds, limits, clock, first_use=reading.first_use)
    if verdict.option is not None:
        return _named(located, found, verdict, verdict.option, limits, clock, one_loop=reading.one_loop)
    return _unnamed(located, found, verdict, folds, limits, clock, reading)


def without_a_name(
    decision: Decision, located: Located, found: Search, reading: Reading, limits: Limits, clock: Clock
) -> Decision:
    """Return the answer that takes the place of one whose name is less likely than something else.

    Parameters
    ----------
    decision : with the name
    located, found, reading, limits, clock : as `decide` took them
    """
    folds = recording_folds(located.problem, reading.calibrations) or block_folds(located.problem)
    judged = held_out(located.problem, None, limits, folds=folds)
    # what an effect in the place of constants explains, they explain
    adequacy = None if decision.held else decision.adequacy
    shown = adequacy.share if adequacy else 0.0
    remaining = located.total_excess if decision.held else decision.remaining_excess
    alone = _moved_alone(located, limits, first_use=reading.first_use)
    verdict = _Verdict(None, judged, found.singles, remaining, adequacy, shown, alone=alone)
    return _unnamed(located, found, verdict, folds, limits, clock, reading)


def _judged(
    located: Located, found: Search, folds: Sequence[Mask], limits: Limits, clock: Clock, *, first_use: bool
) -> _Verdict:
    """The first admissible option, with its held-out quality."""
    problem = located.problem
    rivals, remaining = found.singles, located.total_excess
    judgements: list[Adequacy] = []
    pairs: list[_Verdict] = []
    refuted: set[str] = set()
    shown = 0.0
    alone = _moved_alone(located, limits, first_use=first_use) if located.own_misfit else None
    for option in _asked(located, found, refuted, limits, clock):
        # each recording has a course of its own, of which the others tell nothing
        own = block_folds(problem) if option.chosen.courses else folds
        judged = held_out(option.final, option.chosen, limits, reference=problem, folds=own, tick=clock.tick)
        shows = judged.drop > limits.share * option.chosen.gain or judged.share > limits.share
        adequacy = adequacy_of(option, limits)
        judgements.append(adequacy)
        shown = max(shown, adequacy.share, judged.share)
        admissible = _is_admissible(option, judged, adequacy, limits)
        doubted = shows and not admissible and len(option.chosen.keys) > 1
        if doubted and _is_admissible(option, judged, adequacy, limits, limits.likelier):
            pairs.append(_Verdict(option, judged, option.rivals, option.remaining, adequacy, shown))
        if len(option.chosen.keys) == 1 and _worsens(option, judged):
            refuted.update(option.chosen.keys)
        equivalent: tuple[str, ...] = ()
        if located.own_misfit:
            # what an unchanged device may miss on another path is explained by many effects
            small = located.within_misfit(limits.unlike_misfit) and (
                alone is not None or located.total_excess < limits.channel_excess
            )
            admissible = admissible and not small and len(option.chosen.keys) == 1
            admissible = admissible and not (alone and _leaves_no_more(problem, alone, option))
            equivalent = _as_adequate(option, found, limits)
        rivals = tuple(rival for rival in option.rivals if not refuted.intersection(rival.keys))
        remaining = option.remaining
        # with a body an effect in the place of constants is judged by itself, below
        hidden = found.hidden and not located.nominal.model.description.has_body
        if admissible and (shows or (hidden and _stands_for_constants(option, found.singles, limits))):
            verdict = _Verdict(option, judged, rivals, remaining, adequacy, shown, equivalent)
            return _with_its_second(verdict, pairs, limits)
    if not located.own_misfit:
        alone = _moved_alone(located, limits, first_use=first_use)
    if found.held is not None and alone is None:
        option, reference = found.held.option, found.held.reference
        judged = held_out(
            option.final, option.chosen, limits, reference=reference, folds=folds, tick=clock.tick
        )
        over_constants = max(problem.residual_chi_square - option.chosen.chi_square, 0.0)
        adequacy = adequacy_of(option, limits, most=over_constants)
        if _is_admissible(option, judged, adequacy, limits) and judged.share > limits.share:
            alone = _moved_alone(located, limits, first_use=first_use, held=found.held)
            if alone is None and not _constants_do_it(problem, option, limits):
                verdict = _Verdict(
                    option, judged, option.rivals, option.remaining, adequacy, shown, held=found.held
                )
                return _with_its_second(verdict, pairs, limits)
    likeliest = min(judgements, key=lambda one: one.something_else(limits), default=None)
    nothing = held_out(problem, None, limits, folds=folds)
    return _Verdict(None, nothing, rivals, remaining, likeliest, shown, alone=alone)


def _asked(
    located: Located, found: Search, refuted: set[str], limits: Limits, clock: Clock
) -> Iterator[Option]:
    """The options, and where held-out blocks refute the best single effect, those that explain nearly as much.

    `refuted` holds the keys of those that they have refuted so far: what fits best there is not what fits best.
    """
    yield from found.options
    least = limits.dominated * max((single.gain for single in found.singles), default=0.0)
    near = [
        e for e in found.singles if e.gain >= least and not e.at_bound and not refuted.intersection(e.keys)
    ]
    for single in near[:IN_ITS_PLACE] if refuted else ():
        yield option_of(located.nominal, located.problem, single, found.singles, limits, tick=clock.tick)


def _with_its_second(single: _Verdict, pairs: Sequence[_Verdict], limits: Limits) -> _Verdict:
    """The two that are likelier than not, one of them sure by itself, where the second explains most of what that one leaves."""
    of = single.option
    if of is None or len(of.chosen.keys) > 1:
        return single
    larger = [
        pair
        for pair in pairs
        if pair.option is not None
        and set(of.chosen.keys) < set(pair.option.chosen.keys)
        and pair.remaining < limits.most_of_it * of.remaining
    ]
    return min(larger, key=lambda pair: pair.remaining, default=single)


def _named(
    located: Located,
    found: Search,
    verdict: _Verdict,
    option: Option,
    limits: Limits,
    clock: Clock,
    *,
    one_loop: bool,
) -> Decision:
    """What is named, where it acts, what could stand in its place, and what would tell them apart."""
    final, chosen = option.final, option.chosen
    own = chosen.hypotheses[0].record.id
    alternatives = dict.fromkeys(key.partition(":")[0] for key in verdict.equivalent)
    pairs = [(own, name) for name in alternatives if name != own] or _rival_pairs(
        located.problem, chosen, verdict.rivals, verdict.remaining, limits, one_loop=one_loop
    )
    proposal = None
    if pairs:
        clock.say("designing the next experiment")
        known = (*verdict.rivals, *found.singles)
        rival = next(r for r in known if pairs[0][1] in (h.record.id for h in r.hypotheses))
        proposal = propose(
            located.problem, located.nominal, chosen, rival, limits, names=pairs[0], say=clock.say
        )
    residual = final.residual - chosen.deviation
    drift = _drift(final, residual, verdict.judged, chosen)
    mimics: tuple[Hypothesis, ...] = ()
    if drift.significant(limits.drift_p):
        others = [h for h in found.candidates if h.key not in chosen.keys]
        held = _with_constants_held(final)
        mimics = _mimics_of_constants(score(held, others, residual, tick=clock.tick), limits)
    return Decision(
        verdict="differs", final=final, chosen=chosen, judged=verdict.judged, rivals=verdict.rivals,
        remaining_excess=verdict.remaining, unnamed=None,
        breakdown=tuple(breakdown(final, trace(final), floor=0.0)), rival_pairs=tuple(pairs), proposal=proposal,
        drift=drift, mimics=mimics, adequacy=verdict.adequacy, equivalent=verdict.equivalent,
        held=verdict.held,
    )  # fmt: skip


def _unnamed(
    located: Located,
    found: Search,
    verdict: _Verdict,
    folds: Sequence[Mask],
    limits: Limits,
    clock: Clock,
    reading: Reading,
) -> Decision:
    """No name: agreement, moved constants, or an excess that only a correction without a name describes."""
    problem, unnamed = located.problem, None
    loud = located.is_loud(limits)
    if loud:
        clock.say("shaping what has no name")
        unnamed = fit_nonparametric_correction(problem, located.remaining, block_folds(problem), limits)
    verdict_word: Literal["agrees", "drifted", "differs"] = "differs"
    where, proposal = located.breakdown, None
    drift = verdict.alone or _drift(problem, problem.residual, verdict.judged)
    mimics: tuple[Hypothesis, ...] = ()
    described = 0.0 if unnamed is None else max(unnamed.share, verdict.shown)
    small = unnamed is not None and _is_small(located, verdict.judged, limits)
    predicted = described >= limits.share
    asked = small and predicted and not reading.first_use
    calibrated = _as_calibrated(located, verdict.judged) if asked else ""
    if unnamed is None or (small and (calibrated or not predicted)):
        # more residual than noise at most, and nothing that predicts it: the fitted loops' own misfit
        unnamed, verdict_word = None, "agrees"
        if calibrated:
            drift = _beside_what_is_left(_drift(problem, problem.residual, verdict.judged), located)
        if (
            drift.significant(limits.drift_p)
            and not reading.first_use
            and _shows(problem, verdict.judged, limits)
        ):
            verdict_word = "drifted"
            held = _with_constants_held(problem)
            scores = score(held, found.candidates, problem.residual, tick=clock.tick)
            mimics = _mimics_of_constants(scores, limits, found.singles)
            where = tuple(breakdown(problem, problem.nuisance.thermal @ drift.weights, floor=0.0))
            proposal = by_hand(mimics)
    taken_up: dict[str, float] = {}
    # what the values show by themselves, steps of a converter for one, is no distance from the law
    if verdict_word == "agrees" and located.own_misfit and not reading.first_use and not reading.evident:
        judged = verdict.judged
        far = {c: judged.before[c] / judged.floor[c] for c in located.own_misfit}
        taken_up = {c: ratio for c, ratio in far.items() if ratio > limits.as_it_is}
        verdict_word = "differs" if taken_up else verdict_word
    if verdict_word == "differs":
        drift = _beside_what_is_left(drift, located)
        best = verdict.rivals[0].hypotheses if verdict.rivals else ()
        proposal = without_explanation(unnamed.shapes if unnamed else (), best)
    return Decision(
        verdict=verdict_word, final=problem, chosen=None, judged=verdict.judged, rivals=verdict.rivals,
        remaining_excess=verdict.remaining, unnamed=unnamed, breakdown=where, rival_pairs=(), proposal=proposal,
        drift=drift, mimics=mimics, adequacy=verdict.adequacy,
        unlike_noise=loud and unnamed is None, taken_up=taken_up, as_calibrated=calibrated,
        alone=verdict.alone if verdict_word == "differs" and not reading.first_use else None,
    )  # fmt: skip


def _moved_alone(
    located: Located, limits: Limits, *, first_use: bool, held: Held | None = None
) -> Drift | None:
    """Few constants that explain by themselves, or as well as an effect in their place, what has changed since calibration."""
    if first_use:
        return None
    if held is None:
        return moved_alone(located.problem, limits)
    problem = located.problem
    rival = left_by(problem, held.option.chosen.effects, np.zeros(problem.origin.size))
    return moved_alone(problem, limits, rival=rival)


def _constants_do_it(problem: LinearisedProblem, option: Option, limits: Limits) -> bool:
    """Whether no more constants than an effect has parameters leave no more than it does, loops as calibrated.

    Then it explains nothing by less: a slow body with the time constant of the film's own is that time constant, moved.
    """
    rival = left_by(problem, option.chosen.effects, np.zeros(problem.origin.size))
    most = (
        limits.alone_most if option.chosen.courses else min(len(option.chosen.coordinates), limits.alone_most)
    )
    return constants_leave(problem, most) <= rival


def _leaves_no_more(problem: LinearisedProblem, alone: Drift, option: Option) -> bool:
    """Whether constants that explain by themselves leave no more than an effect does, loops as the calibration left them."""
    rival = left_by(problem, option.chosen.effects, np.zeros(problem.origin.size))
    return left_by(problem, {}, alone.weights) <= rival


def _drift(
    problem: LinearisedProblem, residual: Floats, judged: HeldOut, chosen: Explanation | None = None
) -> Drift:
    """The move of the constants that a residual (N,) leads to, beside what is named.

    On a device without body what a law misses on one path is not what it misses on another, and constants make up for it: the
    standard deviations are wider by the error on held-out blocks over that of the calibration.
    """
    drift = drift_of(problem, residual, chosen)
    if problem.nominal.model.description.has_body:
        return drift
    return drift.widened(max(1.0, *(judged.after[c] / judged.floor[c] for c in judged.after)))


def _beside_what_is_left(drift: Drift, located: Located) -> Drift:
    """The same move where a body's device shows more than it and noise: its standard deviations are those of what is left."""
    if not located.nominal.model.description.has_body:  # wider already, by its error on held-out blocks
        return drift
    return drift.widened(float(np.sqrt(1.0 + max(0.0, *located.excess.values()))))


def _shows(problem: LinearisedProblem, judged: HeldOut, limits: Limits) -> bool:
    """Whether what constants take up is most of what is missed; without body, more than the law misses of its calibration."""
    if problem.nominal.model.description.has_body:
        return True
    before, after, floor = (
        {c: e[c] ** 2 for c in judged.after} for e in (judged.before, judged.after, judged.floor)
    )
    return any(
        before[c] - after[c] > max(floor[c], limits.moved_share * (before[c] - floor[c])) for c in before
    )


def _with_constants_held(problem: LinearisedProblem) -> LinearisedProblem:
    """The same problem, in which another day has moved no constant: what does as much as a move gains as much there."""
    free = np.array([not constant.held for constant in problem.constants], dtype=bool)
    nuisance = problem.nuisance
    return replace(problem, nuisance=replace(nuisance, thermal=nuisance.thermal * free))


def _is_small(located: Located, judged: HeldOut, limits: Limits) -> bool:
    """Whether every channel's error beyond its noise is one that fitted loops make, of the calibration too."""
    span = located.nominal.span
    if max(located.excess.values()) > limits.unlike_law * (1.0 + located.left_out):
        return False
    return all(
        judged.after[c] ** 2 - judged.floor[c] ** 2 < (limits.law_misfit * span[c]) ** 2 for c in judged.after
    )


def _as_calibrated(located: Located, judged: HeldOut) -> str:
    """The channel that most of the excess is in, if what is left is no larger, r.m.s., than in parts of its calibration left out.

    A law that misses its own calibration by many noises wanders about another path faster, and no further: what predicts a
    part of that is no physics. Empty where it is further, and without body, where that is asked of all channels.
    """
    count = located.problem.count_by_channel
    channel = max(located.excess, key=lambda c: located.excess[c] * count.get(c, 0.0))
    sensor = located.nominal.model.sensors.get(channel)
    if sensor is None or sensor.misfit <= 0.0 or not located.nominal.model.description.has_body:
        return ""
    return channel if judged.after[channel] <= sensor.misfit else ""


def _mimics_of_constants(
    scores: Sequence[Score], limits: Limits, singles: Sequence[Explanation] = ()
) -> tuple[Hypothesis, ...]:
    """Effects that save at least half as much of a move of the nuisance model as the best of them does, best first."""
    gains: dict[str, tuple[float, Hypothesis]] = {}
    found = [(s.gain, s.hypothesis) for s in scores] + [(e.gain, e.hypotheses[0]) for e in singles]
    for gain, hypothesis in sorted(found, key=lambda item: -item[0]):
        gains.setdefault(hypothesis.record.id, (gain, hypothesis))
    best = max((gain for gain, _ in gains.values()), default=0.0)
    return tuple(h for gain, h in gains.values() if gain > max(limits.mimic * best, limits.faint))[:4]


def _is_admissible(
    option: Option, judged: HeldOut, adequacy: Adequacy, limits: Limits, doubt: float = 0.0
) -> bool:
    """Whether an explanation is significant, stable, adequate, physical, harms no channel, and ends flat what it cuts off.

    `doubt` is the probability of something else that is too much, by default that of the limits.
    """
    chosen = option.chosen
    return (
        _significant(chosen, limits)
        and judged.stable
        and adequacy.something_else(limits) < (doubt or limits.doubt)
        and adequacy.elsewhere < limits.elsewhere
        and not _like_the_rest(option, adequacy, limits)
        and not chosen.at_bound
        and not _worsens(option, judged)
        and ends_flat(option, limits)
    )


def _like_the_rest(option: Option, adequacy: Adequacy, limits: Limits) -> bool:
    """Whether a channel may be off by as little without a reason, and one that the explanation leaves alone is by more."""
    samples = sum(option.final.count_by_channel[channel] for channel in reached(option))
    explained = max(option.chosen.gain, 0.0) / max(samples, 1.0)
    return explained < limits.channel_excess and adequacy.elsewhere > explained


def _worsens(option: Option, judged: HeldOut) -> bool:
    """Whether a channel that an explanation reaches is predicted worse with it than without, by more than its noise."""
    return any(judged.after[c] > judged.before[c] + judged.floor[c] for c in reached(option))


def _stands_for_constants(option: Option, singles: Sequence[Explanation], limits: Limits) -> bool:
    """Whether a change that the nuisance model could take up by its constants is what one effect is, and no other.

    On held-out blocks such an effect gains nothing, as the constants are moved there too. What tells is how far they
    would have to move from the calibration: a dead time that has doubled is named, a gain that many effects mimic is not.
    Those that act on the same sensor count as one here: which of them it is, their probabilities tell.
    """
    chosen = option.chosen
    own = chosen.hypotheses[0]

    def one_with_it(other: Hypothesis) -> bool:
        return own.record.id == other.record.id or (bool(own.signal) and other.signal == own.signal)

    others = [e.gain for e in singles if not one_with_it(e.hypotheses[0])]
    return len(chosen.keys) == 1 and chosen.gain - max(others, default=0.0) > limits.apart


def _equivalent(option: Option, singles: Sequence[Explanation], limits: Limits) -> tuple[str, ...]:
    """Keys of the single effects that gain nearly as much as an option, best first, its own among them; empty for it alone.

    Beside a device's own misfit a little more gain is no evidence: on one response a lag, an average and a late clock differ
    by less. Gains are compared as the search found them: the option alone was fitted about itself since.
    """
    chosen = option.chosen
    own = min([chosen.gain, *(single.gain for single in singles if single.keys == chosen.keys)])
    gains = {chosen.keys[0]: chosen.gain}
    for single in singles:
        known = {key.partition(":")[0] for key in gains}  # of one effect on several signals the best
        if (
            single.keys[0].partition(":")[0] not in known
            and single.gain >= limits.rival_of_misfit * own
            and not single.at_bound
        ):
            gains[single.keys[0]] = single.gain
    return tuple(sorted(gains, key=lambda key: -gains[key])) if len(gains) > 1 else ()


def _as_adequate(option: Option, found: Search, limits: Limits) -> tuple[str, ...]:
    """Keys of the effects that gain nearly as much as an option and leave no more than it does or an unchanged device shows.

    Each is fitted about itself, as the option was: what holds only where the simulation is linear does not tell what is left.
    """
    own = option.chosen
    most = limits.unlike_misfit * max(1.0, farthest_over_misfit(option) / limits.own_misfit)
    gains = {one.keys[0]: one.gain for one in found.singles}
    same = tuple(
        key
        for key in _equivalent(option, found.singles, limits)
        if key == own.keys[0]
        or found.beyond.get(key, np.inf) <= most
        or gains[key] >= limits.equal_of_misfit * own.gain
    )
    return same if len(same) > 1 else ()


def told_as(decision: Decision, equivalent: tuple[str, ...]) -> Decision:
    """Return the decision told as one of several effects, or as one alone, which has no rival then.

    Parameters
    ----------
    decision : with a name
    equivalent : as of `Decision`
    """
    if decision.equivalent and not equivalent:
        return replace(decision, equivalent=(), rival_pairs=(), proposal=None)
    return replace(decision, equivalent=equivalent)


def _significant(explanation: Explanation, limits: Limits) -> bool:
    """Whether the magnitudes of every effect are told from nothing by several standard deviations, together."""
    return all(
        explanation.distance(index) >= limits.sigmas
        for index, hypothesis in enumerate(explanation.hypotheses)
        if hypothesis.magnitudes and hypothesis.key not in explanation.courses
    ) and all(
        explanation.std(index, name)
        < limits.switching
        * abs(values.get(hypothesis.switches[-1], HUGE) - values.get(hypothesis.switches[0], -HUGE))
        for index, (hypothesis, values) in enumerate(
            zip(explanation.hypotheses, explanation.values, strict=True)
        )
        for name in hypothesis.switches
        if abs(values.get(name, np.inf)) < HUGE and len(hypothesis.switches) == 2
    )


def _rival_pairs(
    problem: LinearisedProblem,
    chosen: Explanation | None,
    rivals: Sequence[Explanation],
    remaining: float,
    limits: Limits,
    *,
    one_loop: bool,
) -> list[tuple[str, str]]:
    """Effects that fit as well as a named one, within what the data can tell."""
    if chosen is None:
        return []
    reference = next((r for r in rivals if set(r.keys) == set(chosen.keys)), chosen)
    limit = limits.rival * (1.0 + max(remaining, 0.0))
    if one_loop and len(chosen.keys) == 1:
        as_one_loop = (1.0 - limits.dominated) * behind_the_loop(problem, reference.gain)
        if not problem.nominal.model.description.has_body:
            as_one_loop = min(as_one_loop, limit * problem.count / limits.samples_of_one_loop)
        limit = max(limit, as_one_loop)
    pairs: list[tuple[str, str]] = []
    for rival in rivals:
        ours = [k.split(":")[0] for k in chosen.keys if k not in rival.keys]
        theirs = [k.split(":")[0] for k in rival.keys if k not in chosen.keys]
        close = rival.chi_square - reference.chi_square < limit and not rival.at_bound
        if len(rival.keys) == len(chosen.keys) and len(ours) == 1 and close and ours != theirs:
            pair = (ours[0], theirs[0])
            if pair not in pairs:
                pairs.append(pair)
    return pairs
