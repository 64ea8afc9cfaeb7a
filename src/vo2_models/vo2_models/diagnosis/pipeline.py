"""The diagnosis as one function: recordings and a fitted simulation in, an answer with its evidence out."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from vo2_models.device.coefficients import HUGE
from vo2_models.diagnosis.assemble_diagnosis import assemble_diagnosis
from vo2_models.diagnosis.check import Finding, Unusable, check_recording
from vo2_models.diagnosis.decide import HeldOut, Thresholds, block_folds, held_out
from vo2_models.diagnosis.explain import BRIEF, Explanation, Score, fit_jointly, score, switched
from vo2_models.diagnosis.hypotheses import Hypothesis, hypotheses
from vo2_models.diagnosis.locate import Breakdown, breakdown, one_loop
from vo2_models.diagnosis.next_experiment import by_hand, propose
from vo2_models.diagnosis.noise import fit_noise
from vo2_models.diagnosis.nominal import LARGE_MOVE, Nominal, Response, loop_ends
from vo2_models.diagnosis.nonparametric_correction import (
    NonparametricCorrection,
    fit_nonparametric_correction,
)
from vo2_models.diagnosis.nuisance import coverage, loop_shapes
from vo2_models.diagnosis.pairs import Option, bend, option_of, pair_of, trace
from vo2_models.diagnosis.parallel import parallel_map
from vo2_models.diagnosis.part import Part, prepare
from vo2_models.diagnosis.problem import LinearisedProblem, linearise_problem
from vo2_models.diagnosis.result import Diagnosis, NextExperiment
from vo2_models.parameters import Value
from vo2_models.recording import Recording

__all__ = ["Study", "diagnose", "study"]

Floats = NDArray[np.float64]
Progress = Callable[[float, str], None]
SHORTLIST = 6
"""Hypotheses that are refitted in full."""
SWITCHING_UNCERTAINTY = 0.5
"""Standard deviation of a switching time, as a share of how long it was on, from which the switching is made up."""
FAINT = 25.0
"""Score of a hypothesis from which a refit could make it worth a name."""
ROOM = 0.9
"""Share of a squared move of the constants from which it is the ambient temperature's alone."""
QUIET = 1.4
"""Residual power over noise power up to which a channel's residual is taken for its noise."""
ONE_LOOP = Finding(
    "one loop",
    "the film went over one and the same loop only, on which many effects look alike, and may look like another loop: "
    "steps, smaller loops and other rates would tell more",
)
UNSEEN = 50.0
"""An effect whose typical size would change chi-square by less than this is not excited."""


@dataclass(frozen=True)
class Study:
    """Everything behind a diagnosis: what the report draws and the next experiment is designed from.

    Attributes
    ----------
    nominal : fitted simulation
    problem : the problem, about the nominal simulation
    final : the problem about the best explanation (the same where there is none)
    findings : limits of the data
    scores : all hypotheses by promise
    singles : refitted single explanations, best first
    chosen : what is named, None for nothing
    rivals : explanations with one effect replaced, best first
    outside : correction without a name, None where not needed
    judged : held-out quality of `chosen` (or of the nuisance model alone)
    named_share : share of the excess that the named effects explain on held-out blocks
    breakdown : where the excess is
    excess : channel -> excess power over noise power, nuisance model refitted
    total_excess : the same of all channels
    differs : whether the excess counts
    not_excited : ids of effects that these recordings would not show
    rival_pairs : named effect, rival that the recordings do not separate from it
    proposal : what to record next
    moved : (t,) how far the nuisance model moved its thermal parameters beside what is named, in their standard deviations
    mimics : effects that would look like that move, best first; none where it is small
    one_loop : whether the film went over one loop only, on which many effects look alike
    """

    nominal: Nominal
    problem: LinearisedProblem
    final: LinearisedProblem
    findings: tuple[Finding, ...]
    thresholds: Thresholds
    scores: tuple[Score, ...] = ()
    singles: tuple[Explanation, ...] = ()
    chosen: Explanation | None = None
    rivals: tuple[Explanation, ...] = ()
    outside: NonparametricCorrection | None = None
    judged: HeldOut | None = None
    breakdown: tuple[Breakdown, ...] = ()
    excess: Mapping[str, float] = field(default_factory=dict)
    total_excess: float = 0.0
    remaining_excess: float = 0.0
    differs: bool = False
    not_excited: tuple[str, ...] = ()
    rival_pairs: tuple[tuple[str, str], ...] = ()
    proposal: NextExperiment | None = None
    moved: Floats = field(default_factory=lambda: np.zeros(0))
    mimics: tuple[Hypothesis, ...] = ()
    one_loop: bool = False
    seconds: float = 0.0

    @property
    def constants_chi_square(self) -> float:
        """Squared move of the thermal parameters, in their standard deviations."""
        return float(self.moved @ self.moved)


class _Clock:
    """Progress in shares of the expected number of simulations."""

    def __init__(self, report: Progress, expected: int) -> None:
        self.report, self.expected, self.done, self.text = report, expected, 0, ""
        self.lock = threading.Lock()

    def say(self, text: str) -> None:
        self.text = text
        self.report(min(self.done / self.expected, 0.99), text)

    def tick(self) -> None:
        with self.lock:  # fits run side by side
            self.done += 1
            if self.done % 16 == 0:
                self.report(min(self.done / self.expected, 0.99), self.text)


def diagnose(
    recordings: Sequence[Recording],
    model: Mapping[str, Value] | Nominal,
    *,
    progress: Progress = lambda share, text: None,
) -> Diagnosis:
    """Compare recordings with a fitted simulation and say what was left out.

    Parameters
    ----------
    recordings : of one device, taken together
    model : flat `model.*` parameters as `load_model_parameters` reads them
    progress : called with the share done, 0 to 1, and what is being done

    Raises
    ------
    Unusable : (a ValueError) data or model with which nothing can be said; one line with the reason.
    """
    return assemble_diagnosis(study(recordings, model, progress=progress))


def study(
    recordings: Sequence[Recording],
    model: Mapping[str, Value] | Nominal,
    *,
    thresholds: Thresholds | None = None,
    progress: Progress = lambda share, text: None,
    names: Sequence[str] = (),
) -> Study:
    """As `diagnose`, with the evidence kept."""
    began = time.perf_counter()
    clock = _Clock(progress, 700)
    clock.say("checking the data")
    if not recordings:
        raise Unusable("recording: found none, need at least one")
    nominal = model if isinstance(model, Nominal) else Nominal.from_parameters(model)
    # the cores are taken side by side: threads inside BLAS would only wait for each other
    with threadpool_limits(1, user_api="blas"):
        found = _studied(recordings, nominal, thresholds or Thresholds(), clock, names)
    return replace(found, seconds=time.perf_counter() - began)


def _studied(
    recordings: Sequence[Recording],
    nominal: Nominal,
    limits: Thresholds,
    clock: _Clock,
    names: Sequence[str],
) -> Study:
    """As `study`, with a clock that is running; its `seconds` are still to be filled in."""
    findings: list[Finding] = []
    parts = []
    for number, recording in enumerate(recordings, 1):
        name = names[number - 1] if names else f"recording {number}"
        findings += check_recording(recording, nominal, name=name)
        parts.append(prepare(recording, nominal, name=name))
    clock.say("simulating the recordings")
    shapes = loop_shapes(nominal)
    started = [
        _detect_initial_state(part, replace(nominal, corrections={c: s.fold() for c, s in shapes.items()}))
        for part in parts
    ]
    parts, findings = _mask_after_gaps(started, nominal, findings)
    paths = [response.temperature for _, response in started]
    parts, findings = _mask_uncovered(parts, paths, nominal, tuple(shapes), findings)
    repeating = one_loop(paths, [part.dt for part in parts])
    if repeating:
        findings = [*findings, ONE_LOOP]
    problem = linearise_problem(nominal, parts, shapes=shapes, say=clock.say)
    problem = _relinearise_constants(nominal, problem, clock)
    nominal, problem = _refine_noise_model(nominal, problem, clock)
    problem = _relinearise_constants(nominal, problem, clock)
    q = problem.residual_chi_square
    left = problem.apply_inverse_covariance(problem.residual)
    excess, total = _excess(problem, left, q)
    base = Study(
        nominal, problem, problem, tuple(findings), limits, excess=excess, total_excess=total,
        breakdown=tuple(breakdown(problem, left)), one_loop=repeating,
    )  # fmt: skip
    return _search_and_decide(base, clock)


def _detect_initial_state(part: Part, nominal: Nominal) -> tuple[Part, Response]:
    """Take a recording as begun at its first current where that fits its first samples far better than a cold start."""
    tau = nominal.model.scalars["thermal.time_constant"]
    first = int(np.clip(np.ceil(5 * tau / part.dt), 3, part.size // 10))
    cold, warm = (nominal.respond(part.current, part.dt, settled=settled) for settled in (False, True))
    misses = []
    for response in (cold, warm):
        miss = 0.0
        for channel in part.channels:
            noise = nominal.noise[channel].level
            gap = (part.observed[channel] - response.channels[channel])[:first][part.valid[channel][:first]]
            miss += float(np.sum(np.minimum((gap / noise) ** 2, 1e6)))
        misses.append(miss)
    if misses[1] < 0.2 * misses[0] - 100:
        return replace(part, settled=True), warm
    return part, cold


def _mask_after_gaps(
    started: Sequence[tuple[Part, Response]], nominal: Nominal, findings: Sequence[Finding]
) -> tuple[list[Part], list[Finding]]:
    """Leave out what follows a long gap until the loops have forgotten it: until the film was outside of them."""
    low, high = loop_ends(nominal.device)
    parts, lost, count = [], 0, 0
    for part, response in started:
        known = np.ones(part.size, dtype=bool)
        outside = np.flatnonzero((response.temperature < low) | (response.temperature > high))
        settling = int(np.ceil(8 * nominal.model.scalars["thermal.time_constant"] / part.dt))
        for begin, end in part.blind:
            later = outside[outside >= end + settling]
            known[begin : int(later[0]) if later.size else part.size] = False
        parts.append(replace(part, valid={c: good & known for c, good in part.valid.items()}))
        lost, count = lost + int(np.count_nonzero(~known)), count + part.size
    if not lost:
        return parts, list(findings)
    if lost > 0.7 * count:
        raise Unusable(
            f"recordings: after gaps the state of the loops is unknown for {lost} of {count} samples; record without "
            "gaps, or give the pieces between them as recordings of their own"
        )
    forgotten = Finding(
        "forgotten",
        f"{100 * lost / count:.1f} % of the samples lie in or after long gaps, before the film left the loops: "
        "they are not judged",
    )
    return parts, [*findings, forgotten]


def _mask_uncovered(
    given: Sequence[Part],
    paths: Sequence[Floats],
    nominal: Nominal,
    channels: Sequence[str],
    findings: Sequence[Finding],
) -> tuple[list[Part], list[Finding]]:
    """Leave out of these channels what happens at temperatures (n,) [degC] that the calibration did not cover."""
    covered = coverage(nominal)
    parts, beyond, count = [], 0, 0
    for part, path in zip(given, paths, strict=True):
        inside = covered.holds(path)
        beyond, count = beyond + int(np.count_nonzero(~inside)), count + part.size
        valid = {c: good & inside if c in channels else good for c, good in part.valid.items()}
        parts.append(replace(part, valid=valid))
    if not beyond:
        return parts, list(findings)
    if count - beyond < 100:
        raise Unusable(
            f"recordings: {beyond} of {count} samples are outside of {covered}, which is what the calibration covers; "
            "fit a calibration that covers them"
        )
    uncovered = Finding(
        "beyond",
        f"{100 * beyond / count:.1f} % of the samples are at temperatures outside of {covered}, "
        "which the calibration hardly covers: they are not judged",
    )
    return parts, [*findings, uncovered]


def _relinearise_constants(
    nominal: Nominal, problem: LinearisedProblem, clock: _Clock, *, rounds: int = 3
) -> LinearisedProblem:
    """Move to where the nuisance model's own refit puts the thermal parameters, until they stay: it is not linear in them."""
    for _ in range(rounds):
        count = len(problem.names)
        shift = problem.fit_nuisance(problem.residual)[-count:] if count else np.zeros(0)
        if not count or float(np.max(np.abs(shift - problem.origin))) < 0.7:
            break
        moved = linearise_problem(
            nominal, problem.parts, shift=shift, shapes=problem.shapes, loops=problem.loops, say=clock.say
        )
        if moved.residual_chi_square >= problem.residual_chi_square - 10.0:
            break
        problem = moved
    return problem


def _refine_noise_model(
    nominal: Nominal, problem: LinearisedProblem, clock: _Clock
) -> tuple[Nominal, LinearisedProblem]:
    """Take level and colour of a channel's noise from the recording itself where little but noise is left in it.

    A calibration is slow and its noise may have another colour; where an effect is in the channel its residual is
    no noise, and the calibration's stands.
    """
    # a weight stands for misfit that is expected: what there is of it must not pass for a low noise
    left = problem.apply_inverse_covariance(problem.residual) / np.where(
        problem.weight > 0, problem.weight, 1.0
    )
    before = nominal.noise
    noise = dict(before)
    for channel in dict.fromkeys(row.channel for row in problem.rows):
        rows = [row for row in problem.rows if row.channel == channel]
        power = [float(np.mean(left[row.where][problem.weight[row.where] > 0] ** 2)) for row in rows]
        if not all(0.3 < p < QUIET for p in power):
            continue
        known = noise[channel]
        plain = [known.color(left[row.where]) for row in rows]
        found = fit_noise(
            np.concatenate(plain), np.concatenate([problem.weight[row.where] > 0 for row in rows])
        )
        if 0.5 < found.level / known.level < 1.6:
            noise[channel] = found
    if noise == dict(nominal.noise):
        return nominal, problem
    nominal = replace(nominal, noise=noise)
    # what a weight stands for is in the noise already where that was found in the recording
    shapes = {
        channel: shape if noise.get(channel) is before.get(channel) else replace(shape, rough=0.0)
        for channel, shape in loop_shapes(nominal).items()
    }
    return nominal, linearise_problem(
        nominal, problem.parts, shift=problem.origin, shapes=shapes, loops=problem.loops, say=clock.say
    )


def _excess(problem: LinearisedProblem, left: Floats, q: float) -> tuple[dict[str, float], float]:
    """Excess power over noise power, by channel and of all: each channel's part of chi-square over its samples."""
    own: dict[str, list[float]] = {}
    for row, _, _ in problem.iterate():
        energy = float(problem.residual[row.where] @ left[row.where])
        count = float(np.count_nonzero(problem.weight[row.where]))
        total = own.setdefault(row.channel, [0.0, 0.0])
        total[0] += energy
        total[1] += count
    return {c: e / max(n, 1.0) - 1.0 for c, (e, n) in own.items()}, q / max(problem.count, 1) - 1.0


def _search_and_decide(base: Study, clock: _Clock) -> Study:
    """Search, decide, and judge on held-out blocks.

    Where the nuisance model had to move far to absorb a mismatch, it may have absorbed an effect: hypotheses are then tried
    about the unmoved simulation as well, and the better of both counts.
    """
    problem, limits = base.problem, base.thresholds
    device = base.nominal.device
    left = problem.apply_inverse_covariance(problem.residual)
    candidates = hypotheses(problem, device, left)
    clock.expected = 2 * sum(len(h.starts) for h in candidates) + 40 * SHORTLIST + 200
    clock.say(f"trying {len(candidates)} effects")
    problems = [problem]
    if problem.origin.size and float(np.max(np.abs(problem.origin))) > LARGE_MOVE:
        problems.append(
            linearise_problem(
                base.nominal, problem.parts, shapes=problem.shapes, loops=problem.loops, say=clock.say
            )
        )
    scored = [score(problem, candidates, problem.residual, tick=clock.tick) for problem in problems]
    scores = scored[0]
    clock.say("refitting the most promising")
    q_base = problem.residual_chi_square
    shortlist = 2 * SHORTLIST if base.one_loop else SHORTLIST
    promising = [
        (problem, s)
        for problem, ranked in zip(problems, scored, strict=True)
        for s in [s for s in ranked if s.gain > max(0.08 * ranked[0].gain, FAINT)][:shortlist]
    ]

    def refitted(item: tuple[LinearisedProblem, Score]) -> Explanation:
        problem, s = item
        start = switched(problem, s.hypothesis, s.start, problem.residual, tick=clock.tick)
        return fit_jointly(problem, [s.hypothesis], [start], iterations=BRIEF, tick=clock.tick)

    fits: dict[str, tuple[LinearisedProblem, Explanation]] = {}
    for (problem, s), fit in zip(promising, parallel_map(refitted, promising), strict=True):
        known = fits.get(s.hypothesis.key)
        if known is None or fit.chi_square < known[1].chi_square:
            fits[s.hypothesis.key] = problem, replace(fit, gain=q_base - fit.chi_square)
    most = max((fit.gain for _, fit in fits.values()), default=0.0)

    def finished(item: tuple[LinearisedProblem, Explanation]) -> tuple[LinearisedProblem, Explanation]:
        problem, fit = item
        if fit.gain <= 0.5 * most:  # those that may be the answer, or its rivals, to the end
            return item
        again = fit_jointly(problem, fit.hypotheses, fit.values, tick=clock.tick)
        return (
            (problem, replace(again, gain=q_base - again.chi_square))
            if again.chi_square < fit.chi_square
            else item
        )

    fits = dict(zip(fits, parallel_map(finished, fits.values()), strict=True))
    singles = [fit for _, fit in fits.values()]
    singles.sort(key=lambda e: e.chi_square + len(e.coordinates) * np.log(problem.count))
    not_excited = tuple(_not_excited(scores))
    options = _options(base, singles, candidates, clock)
    clock.say("judging on held-out blocks")
    final, chosen, rivals, remaining = problem, None, tuple(singles), base.total_excess
    outside, absorbed = None, False
    for option in options:
        judged = held_out(option.final, option.chosen, reference=problem, tick=clock.tick)
        shows = judged.drop > limits.share * option.chosen.gain or judged.share > limits.share
        sound = _is_admissible(option, judged, singles, problem, limits)
        rivals, remaining = option.rivals, option.remaining
        absorbed_here = sound and len(problems) > 1
        if sound and (shows or (absorbed_here and _stands_for_constants(option, singles, base))):
            final, chosen = option.final, option.chosen
            break
        absorbed |= absorbed_here
    if chosen is None:
        judged = held_out(problem, None)
        loud = base.total_excess > limits.excess or max(base.excess.values()) > limits.channel_excess
        if loud:
            clock.say("shaping what has no name")
            outside = fit_nonparametric_correction(problem, left, block_folds(problem))
        silent = outside is None or (outside.share < limits.share and base.total_excess < limits.plain)
        if silent:
            # more residual than noise at most, and nothing in it that predicts anything
            quiet = replace(
                base, scores=tuple(scores), singles=tuple(singles), judged=judged, remaining_excess=remaining,
                not_excited=not_excited, rivals=rivals, moved=_thermal_move(problem, problem.residual),
            )  # fmt: skip
            mimics = _mimics_of_constants(scores, singles)
            if not absorbed and quiet.constants_chi_square <= limits.constants_chi_square:
                return replace(quiet, mimics=mimics)
            acting = problem.nuisance.thermal @ quiet.moved
            where = breakdown(problem, acting, floor=0.0)
            return replace(
                quiet, differs=True, mimics=mimics, proposal=by_hand(mimics), breakdown=tuple(where)
            )
    # where it is: where a named effect acts, else where more than noise is left
    acting = problem.apply_inverse_covariance(problem.residual) if chosen is None else trace(final)
    where = breakdown(final, acting, floor=0.0 if chosen else 1.0)
    pairs = _rival_pairs(base, chosen, rivals, remaining)
    proposal = None
    if pairs and chosen is not None:
        clock.say("designing the next experiment")
        rival = next(r for r in rivals if pairs[0][1] in (h.record.id for h in r.hypotheses))
        proposal = propose(problem, base.nominal, chosen, rival, names=pairs[0], say=clock.say)
    told = replace(
        base,
        differs=True,
        rival_pairs=tuple(pairs),
        proposal=proposal,
        final=final,
        scores=tuple(scores),
        singles=tuple(singles),
        chosen=chosen,
        rivals=rivals,
        outside=outside,
        judged=judged,
        remaining_excess=remaining,
        breakdown=tuple(where),
        not_excited=not_excited,
    )
    if chosen is None:
        return told
    residual = final.residual - chosen.deviation
    told = replace(told, moved=_thermal_move(final, residual))
    if told.constants_chi_square <= limits.constants_reported:
        return told
    others = [h for h in candidates if h.key not in chosen.keys]
    return replace(told, mimics=_mimics_of_constants(score(final, others, residual, tick=clock.tick)))


def _thermal_move(problem: LinearisedProblem, residual: Floats) -> Floats:
    """How far the nuisance model moves its thermal parameters for a residual, in their standard deviations."""
    count = len(problem.names)
    return problem.fit_nuisance(residual)[-count:] if count else np.zeros(0)


def _mimics_of_constants(
    scores: Sequence[Score], singles: Sequence[Explanation] = ()
) -> tuple[Hypothesis, ...]:
    """Effects that save at least half as much of a move of the nuisance model as the best of them does, best first."""
    gains: dict[str, tuple[float, Hypothesis]] = {}
    found = [(s.gain, s.hypothesis) for s in scores] + [(e.gain, e.hypotheses[0]) for e in singles]
    for gain, hypothesis in sorted(found, key=lambda item: -item[0]):
        gains.setdefault(hypothesis.record.id, (gain, hypothesis))
    best = max((gain for gain, _ in gains.values()), default=0.0)
    return tuple(h for gain, h in gains.values() if gain > max(0.5 * best, FAINT))[:4]


def _options(
    base: Study, singles: Sequence[Explanation], candidates: Sequence[Hypothesis], clock: _Clock
) -> list[Option]:
    """What could be the answer, best first: two effects, one effect."""
    problem, limits = base.problem, base.thresholds
    first = _best_inside(singles)
    if first is None or first.gain <= limits.least(first.hypotheses[0]):
        return []
    clock.say("linearising about the explanation")
    alone = option_of(base.nominal, problem, first, singles, tick=clock.tick)
    clock.say("looking for a second effect")
    pair = pair_of(base.nominal, problem, alone, candidates, limits, tick=clock.tick)
    if pair is None and first.cornered:
        pair = _pair_in_place_of_one(base, alone, singles, candidates, clock)
    if pair:
        needed = limits.complete_matched if _matched(pair, alone, limits) else limits.complete_pair
        if _complete(pair.chosen, pair.remaining, problem, limits) >= needed:
            return [pair, alone]
    return [alone]


def _pair_in_place_of_one(
    base: Study,
    alone: Option,
    singles: Sequence[Explanation],
    candidates: Sequence[Hypothesis],
    clock: _Clock,
) -> Option | None:
    """Two effects that fit better than one which had to go as far as is physical: it may stand for both of them.

    They begin with the best single effect that keeps away from its bounds, and may resemble each other: both must beat
    what resembles them.
    """
    limits = replace(base.thresholds, second_cosine=1.0)
    inside = next((e for e in singles if not e.cornered), None)
    if inside is None or inside.gain <= limits.least(inside.hypotheses[0]):
        return None
    clock.say("looking for two effects in the place of one")
    other = option_of(base.nominal, base.problem, inside, singles, tick=clock.tick)
    pair = pair_of(base.nominal, base.problem, other, candidates, limits, tick=clock.tick)
    better = pair is not None and pair.chosen.chi_square < alone.chosen.chi_square - limits.rival
    return pair if better else None


def _matched(pair: Option, alone: Option, limits: Thresholds) -> bool:
    """Whether no other partner of one of the two comes near what the other adds."""
    before = alone.chosen.chi_square
    best = min(r.chi_square for r in pair.rivals if set(r.keys) == set(pair.chosen.keys))
    others = [r.chi_square for r in pair.rivals if set(r.keys) != set(pair.chosen.keys)]
    return before - min(others, default=before) < limits.dominated * (before - best)


def _is_admissible(
    option: Option,
    judged: HeldOut,
    singles: Sequence[Explanation],
    problem: LinearisedProblem,
    limits: Thresholds,
) -> bool:
    """Whether an explanation is significant, stable, complete, inside its physical bounds, and harms no channel."""
    chosen = option.chosen
    alone = len(chosen.keys) == 1 and not _dominates(chosen, singles, limits)
    needed = limits.complete_rivalled if alone else limits.complete
    return (
        _significant(chosen, limits)
        and judged.stable
        and _complete(chosen, option.remaining, problem, limits) >= needed
        and not chosen.at_bound
        and not _worsens(option, judged)
        and not _bends(option, limits)
    )


def _best_inside(explanations: Sequence[Explanation]) -> Explanation | None:
    """The best that does not end at a physical bound, unless one that does is better by far."""
    if not explanations:
        return None
    inside = [e for e in explanations if not e.at_bound]
    if inside and inside[0].gain > 0.8 * explanations[0].gain:
        return inside[0]
    return explanations[0]


def _worsens(option: Option, judged: HeldOut) -> bool:
    """Whether a channel that an explanation reaches is predicted worse with it than without, by more than its noise."""
    acting = trace(option.final)
    reached = {row.channel for row in option.final.rows if float(np.sum(acting[row.where] ** 2)) > 1.0}
    return any(judged.after[c] > judged.before[c] + judged.floor[c] for c in reached)


def _bends(option: Option, limits: Thresholds) -> bool:
    """Whether what is named as straight in time leaves a bend that would count as a second effect."""
    leftover = option.final.count * max(option.remaining, 0.0)
    return bend(option) > max(limits.gain, limits.second * leftover)


def _complete(
    explanation: Explanation, remaining: float, problem: LinearisedProblem, limits: Thresholds
) -> float:
    """Share of the excess beyond what unchanged devices show that an explanation takes away."""
    rest = problem.count * max(remaining - limits.slack, 0.0)
    return explanation.gain / (explanation.gain + rest)


def _dominates(chosen: Explanation, singles: Sequence[Explanation], limits: Thresholds) -> bool:
    """Whether no other effect alone comes near the one that is chosen."""
    own = chosen.hypotheses[0].record.id
    alone = max((e.gain for e in singles if e.hypotheses[0].record.id == own), default=chosen.gain)
    others = [e.gain for e in singles if e.hypotheses[0].record.id != own]
    return max(others, default=0.0) < limits.dominated * alone


def _stands_for_constants(option: Option, singles: Sequence[Explanation], base: Study) -> bool:
    """Whether a change that the nuisance model could take up by its constants is what one effect is, and no other.

    On held-out blocks such an effect gains nothing, as the constants are moved there too. What tells is how far they
    would have to move from the calibration: a dead time that has grown is named, a gain that many effects mimic is not.
    Nor is what a room does that has become warmer: that happens by itself.
    """
    move = _thermal_move(base.problem, base.problem.residual) ** 2
    if move[base.problem.names.index("thermal.ambient")] > ROOM * float(np.sum(move)):
        return False
    chosen = option.chosen
    own = chosen.hypotheses[0].record.id
    others = [e.gain for e in singles if e.hypotheses[0].record.id != own]
    return len(chosen.keys) == 1 and chosen.gain - max(others, default=0.0) > base.thresholds.apart


def _significant(explanation: Explanation, limits: Thresholds) -> bool:
    """Whether the magnitudes of every effect are told from nothing by several standard deviations, together."""
    return all(
        explanation.distance(index) >= limits.sigmas
        for index, hypothesis in enumerate(explanation.hypotheses)
        if hypothesis.magnitudes
    ) and all(
        explanation.std(index, name)
        < SWITCHING_UNCERTAINTY * abs(values[hypothesis.switches[-1]] - values[hypothesis.switches[0]])
        for index, (hypothesis, values) in enumerate(
            zip(explanation.hypotheses, explanation.values, strict=True)
        )
        for name in hypothesis.switches
        if abs(values.get(name, np.inf)) < HUGE and len(hypothesis.switches) == 2
    )


def _rival_pairs(
    base: Study, chosen: Explanation | None, rivals: Sequence[Explanation], remaining: float
) -> list[tuple[str, str]]:
    """Effects that fit as well as a named one, within what the data can tell."""
    if chosen is None:
        return []
    reference = next((r for r in rivals if set(r.keys) == set(chosen.keys)), chosen)
    limit = base.thresholds.rival * (1.0 + max(remaining, 0.0))
    if base.one_loop and len(chosen.keys) == 1:
        limit = max(limit, (1.0 - base.thresholds.dominated) * reference.gain)
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


def _not_excited(scores: Sequence[Score]) -> list[str]:
    """Effects that a clearly visible magnitude would not show in these recordings."""
    seen: dict[str, float] = {}
    for s in scores:
        seen[s.hypothesis.record.id] = max(seen.get(s.hypothesis.record.id, 0.0), s.visible)
    return [name for name, q in seen.items() if q < UNSEEN]
