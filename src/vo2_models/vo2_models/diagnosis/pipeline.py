"""The diagnosis as one function: recordings and a fitted simulation in, an answer with its evidence out.

Five stages, each of which returns a record that no later one changes: read, locate, search, decide, report.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from vo2_models.diagnosis.check import Unusable
from vo2_models.diagnosis.corrected_model import distance
from vo2_models.diagnosis.decide import decide, told_as, without_a_name
from vo2_models.diagnosis.drift import days_differ
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.locate import Located, locate
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.progress import Clock, Progress
from vo2_models.diagnosis.read import Reading, read
from vo2_models.diagnosis.report import assemble_diagnosis, doubts_one_of_two, equally_likely, unlikely
from vo2_models.diagnosis.result import Diagnosis
from vo2_models.diagnosis.search import search
from vo2_models.diagnosis.stages import Study
from vo2_models.parameters import Value
from vo2_models.recording import Recording, as_recordings

__all__ = ["diagnose", "study"]

SIMULATIONS = 700
"""What a diagnosis takes, about."""


def diagnose(
    recordings: Recording | Sequence[Recording],
    model: Mapping[str, Value] | Nominal,
    *,
    calibration: Recording | Sequence[Recording] = (),
    progress: Progress = lambda share, text: None,
) -> Diagnosis:
    """Compare recordings with a fitted simulation and say what was left out.

    Parameters
    ----------
    recordings : of one device, with the channels that it has, taken together
    model : flat `model.*` parameters as `load_model_parameters` reads them
    calibration : recordings that the model was fitted to, where what is looked for may have been there already: nominal
        device and effect are then fitted together over all recordings. Without, an effect is a change since
    progress : called with the share done, 0 to 1, and what is being done

    Returns
    -------
    verdict, effects with magnitudes and uncertainties, location, rivals and the next experiment

    Raises
    ------
    Unusable : (a ValueError) data or model with which nothing can be said; one line with the reason.
    """
    return assemble_diagnosis(study(recordings, model, calibration=calibration, progress=progress))


def study(
    recordings: Recording | Sequence[Recording],
    model: Mapping[str, Value] | Nominal,
    *,
    calibration: Recording | Sequence[Recording] = (),
    limits: Limits | None = None,
    progress: Progress = lambda share, text: None,
    names: Sequence[str] = (),
) -> Study:
    """As `diagnose`, with the evidence kept.

    Parameters
    ----------
    recordings, model, calibration, progress : as `diagnose` takes them
    limits : of every decision; those of `Limits` by default
    names : of the calibration and the recordings, in that order, for messages; numbers by default

    Returns
    -------
    what each of the five stages found

    Raises
    ------
    Unusable : (a ValueError) data or model with which nothing can be said; one line with the reason.
    """
    began = time.perf_counter()
    clock, limits = Clock(progress, SIMULATIONS), limits or Limits()
    nominal = model if isinstance(model, Nominal) else Nominal.from_parameters(model)
    recordings, calibration = (
        [nominal.model.description.understood(one) for one in as_recordings(part, name)]
        for name, part in (("recordings", recordings), ("calibration", calibration))
    )
    # the cores run fits in parallel: threads inside BLAS would only wait for each other
    with threadpool_limits(1, user_api="blas"):
        try:
            answer = _study(recordings, calibration, nominal, names, limits, clock)
            if _may_be_of_some_only(answer):
                answer = _day_by_day(answer, [*calibration, *recordings], nominal, limits, clock)
        except Unusable as error:
            raise Unusable(nominal.model.description.in_own_names(str(error))) from error
    return replace(answer, seconds=time.perf_counter() - began)


def _study(
    recordings: Sequence[Recording],
    calibration: Sequence[Recording],
    nominal: Nominal,
    names: Sequence[str],
    limits: Limits,
    clock: Clock,
) -> Study:
    """The five stages over all recordings, in each of which the same acts.

    At first use a slow misfit of the calibration may be what is looked for. As noise it has a colour, which hides whatever is
    slow: where nothing is told beside it, it is judged once more as no noise, and a name counts that explains most of it.
    """
    every = [*calibration, *recordings]

    def judged_by(own: Nominal) -> Study:
        reading = read(every, own, names, limits, clock, calibrations=len(calibration))
        return _answered(reading, locate(reading, limits, clock), limits, clock)

    answer = judged_by(nominal)
    if not answer.reading.first_use or answer.decision.verdict != "agrees":
        return answer
    sharp = nominal.with_slow_misfit_told(limits.slow_misfit)
    if sharp is nominal or not nominal.model.description.has_body:
        return answer
    clock.say("judging what the calibration misses slowly")
    clock.expected += SIMULATIONS
    again = judged_by(sharp)
    judged = again.decision.judged
    explains = any(judged.after[c] < limits.most_of_it * judged.before[c] for c in judged.after)
    return again if again.decision.chosen is not None and explains else answer


def _answered(reading: Reading, located: Located, limits: Limits, clock: Clock) -> Study:
    """Search and decision, about the constants that explain by themselves where these went far."""
    answer = _decided(reading, located, limits, clock)
    alone = answer.decision.alone
    if alone is None or reading.nominal.model.description.has_body:
        return answer
    # on a device without body a constant may be another one altogether, as its lag is with another amplifier
    reading, moves = reading.with_moved(alone)
    located = locate(reading, limits, clock, about=moves)
    return answer if located.is_loud(limits) else _decided(reading, located, limits, clock)


def _decided(reading: Reading, located: Located, limits: Limits, clock: Clock) -> Study:
    """Search and decision over what was read and located."""
    found = search(located, limits, clock, one_loop=reading.one_loop, first_use=reading.first_use)
    decision = decide(located, found, reading, limits, clock)
    answer = Study(reading, located, found, decision, limits, 0.0)
    if decision.chosen is not None and doubts_one_of_two(answer):
        # what a second effect explains, others explain as well: the first alone, where that is adequate
        one = replace(found, options=tuple(o for o in found.options if len(o.chosen.keys) == 1))
        by_itself = decide(located, one, reading, limits, clock)
        if by_itself.chosen is not None:
            found, decision = one, by_itself
            answer = replace(answer, search=found, decision=decision)
    decision = told_as(decision, _told_as_one_of(answer))
    answer = replace(answer, decision=decision)
    while reading.first_use and decision.chosen is not None and distance(answer) > limits.farther:
        # the loops that were fitted along make up for it: no model that has it comes near the recordings
        options = tuple(o for o in found.options if o.chosen.keys != decision.chosen.keys)
        found = replace(found, options=options)
        decision = decide(located, found, reading, limits, clock)
        answer = replace(answer, search=found, decision=decision)
        decision = told_as(decision, _told_as_one_of(answer))
        answer = replace(answer, decision=decision)
    if unlikely(answer):
        answer = replace(answer, decision=without_a_name(decision, located, found, reading, limits, clock))
    return answer


def _told_as_one_of(answer: Study) -> tuple[str, ...]:
    """Keys of the effects of which the answer is one; empty for it alone.

    Loops that are fitted along with it take up what tells a room that takes any course from a gain of the drive that does.
    """
    found, chosen = equally_likely(answer), answer.decision.chosen
    if found or chosen is None or not answer.reading.first_use or len(chosen.keys) > 1 or not chosen.courses:
        return found
    others = [h.key for h in answer.search.candidates if h.record.takes_course and h.key not in chosen.keys]
    return (*chosen.keys, *others) if others else ()


def _may_be_of_some_only(answer: Study) -> bool:
    """Whether what is told may have come between the recordings: no name, several, one that goes on and off or drifts.

    Or, where nothing is named, constants that are not the same in all recordings.
    """
    chosen = answer.decision.chosen
    if len(answer.reading.parts) < 2:
        return False
    if answer.decision.verdict != "differs":
        problem = answer.decision.final
        return not answer.reading.first_use and days_differ(problem, problem.residual, answer.limits.drift_p)
    if chosen is None or any(h.switches for h in chosen.hypotheses):
        return True
    # with calibrations among them, a course that was found is of all, each with its own
    return (bool(chosen.courses) or len(chosen.keys) > 1) and not answer.reading.first_use


def _holds_in_all(answer: Study) -> bool:
    """Whether something is named that recordings show together, and is no course, which may be but another level in each."""
    chosen = answer.decision.chosen
    return chosen is not None and not any(key in chosen.courses for key in chosen.keys)


def _acts_in_each(together: Study) -> bool:
    """Whether the second of two effects that all recordings show together explains a part of each.

    A short recording, or a smooth one, may not show it by itself; that is no reason to take it for one of the others alone.
    """
    chosen = together.decision.chosen
    if chosen is None or len(chosen.keys) < 2 or not _holds_in_all(together):
        return False
    if any(h.switches for h in chosen.hypotheses):  # what goes on and off may do so in some
        return False
    left = {
        frozenset(o.chosen.keys): o.final.chi_square_by_part(o.final.residual - o.chosen.deviation)
        for o in together.search.options
    }
    alone = [chi for keys, chi in left.items() if len(keys) == 1 and keys < set(chosen.keys)]
    both = left.get(frozenset(chosen.keys))
    return both is not None and any(bool(np.all(chi - both > together.limits.rival)) for chi in alone)


def _day_by_day(
    together: Study, recordings: Sequence[Recording], nominal: Nominal, limits: Limits, clock: Clock
) -> Study:
    """The study of those recordings that do not agree by themselves, or of each, where that has an answer.

    Where one that does not agree is a calibration, what differs was there all along.
    """
    parts, first = together.reading.parts, together.reading.calibrations
    # what was found with the calibration is not given up for moved constants
    named_before = bool(first) and together.decision.chosen is not None

    def has_an_answer(answer: Study) -> bool:
        return answer.decision.chosen is not None or (answer.verdict == "drifted" and not named_before)

    def how_far(answer: Study) -> tuple[bool, int, float]:
        """The order of studies: a name before none before moved constants, then by how much is beyond the noise."""
        rank = ("agrees", "drifted", "differs").index(answer.verdict)
        return answer.decision.chosen is not None, rank, answer.located.total_excess

    begun = []
    for recording, part in zip(recordings, parts, strict=True):
        reading = read([recording], nominal, [part.name], limits, clock)
        begun.append((reading, locate(reading, limits, clock)))
    loud = [k for k, (reading, located) in enumerate(begun) if reading.evident or located.is_loud(limits)]
    if any(k < first for k in loud) or (len(loud) == len(parts) and _acts_in_each(together)):
        return together

    def by_themselves(which: Sequence[int]) -> dict[int, Study]:
        clock.expected += SIMULATIONS
        return {k: _answered(*begun[k], limits, clock) for k in which}

    quiet = by_themselves([k for k in range(len(parts)) if k not in loud])
    joint = None
    if 1 < len(loud) < len(parts):
        clock.expected += SIMULATIONS
        some, names = [recordings[k] for k in loud], [parts[k].name for k in loud]
        joint = _study(some, (), nominal, names, limits, clock)
    if not loud:
        told = any(has_an_answer(one) or one.verdict == "differs" for one in quiet.values())
        days = quiet if told and not named_before else {}
    elif joint and has_an_answer(joint) and not _may_be_of_some_only(joint):
        days = quiet | dict.fromkeys(loud, joint)
    else:  # a day of its own for each: what constants take up by themselves differs from one to the next
        alone = by_themselves(loud)
        if joint and has_an_answer(joint):
            explained = all(has_an_answer(one) or one.verdict == "agrees" for one in alone.values())
            days = quiet | (alone if explained else dict.fromkeys(loud, joint))
        elif any(map(has_an_answer, alone.values())):
            days = quiet | alone
        elif quiet and not first and not _holds_in_all(together):
            days = quiet | dict.fromkeys(loud, joint or alone[loud[0]])
        else:
            days = {}
    if not days:
        return together
    answer = max(days.values(), key=how_far)
    return replace(answer, days=tuple((part.name, days[k]) for k, part in enumerate(parts)))
