"""Fifth stage: a study in words and in the records of the file format."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import HUGE
from vo2_models.diagnosis.adequacy import behind_the_loop
from vo2_models.diagnosis.breakdown import Breakdown, breakdown, locate
from vo2_models.diagnosis.check import limits_in_words
from vo2_models.diagnosis.drift import Drift
from vo2_models.diagnosis.evident import QUIET, Evident, located_with
from vo2_models.diagnosis.explain import Explanation, cost
from vo2_models.diagnosis.families import family_of_unnamed
from vo2_models.diagnosis.hypotheses import Hypothesis
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.next_experiment import to_cover, without_explanation
from vo2_models.diagnosis.nominal import loop_ends
from vo2_models.diagnosis.nonparametric_correction import Shape
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.diagnosis.result import (
    Candidate,
    ChannelFit,
    Diagnosis,
    Estimate,
    Location,
    MovedConstant,
    NamedEffect,
    NextExperiment,
    RecordingAnswer,
)
from vo2_models.diagnosis.stages import Study
from vo2_models.effects.record import CHOICE
from vo2_models.identification.calibration_check import noise_level
from vo2_models.numerics.parallel import parallel_map
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = [
    "MODEL_DISCREPANCY",
    "assemble_diagnosis",
    "beside_the_first",
    "course_of",
    "doubts_one_of_two",
    "equally_likely",
    "excess_by_channel",
    "in_own_names",
    "left_by_the_answer",
    "moved_in_place",
    "probabilities",
    "unlikely",
]

Floats = NDArray[np.float64]
OTHERS = 4
"""Sets of constants, that which is told among them, up to which all are written out."""
RARELY, TINY = 1e-3, float(np.finfo(np.float64).tiny)
"""Odds below which no figure is told, and the least number that odds are told against."""
RESPONSE_GAINS = frozenset({"deflection.gain", "resistance.gain"})
EXACT = 1e-3
"""Standard deviation of a parameter that is read off the values, as a share of it: a generous rounding of what is written."""
MODEL_DISCREPANCY = {
    "driver": 0.03,
    "thermal": 0.085,
    "transition": 0.1,
    "terminals": 0.01,
    "structure": 0.045,
    "sensor": 0.015,
}
"""Standard deviation of a parameter, as a share of its value, that no fit can tell: by the stage of its effect.

Two simulations of the same physics that share neither loops nor equations disagree by that much on what fits best. Set
so that with it about nine of ten 90 % intervals of each stage hold the truth on recordings of an independent generator,
of seeds that no published figure comes from.
"""


def assemble_diagnosis(study: Study) -> Diagnosis:
    """Return the diagnosis that a study supports; channels have the names that the device's file gives them."""
    decision, verdict = study.decision, study.verdict
    candidates, probability = _candidates(study) if decision.verdict == "differs" else ([], {})
    effects = _named(study, probability) if decision.verdict == "differs" else []
    if decision.equivalent:
        effects = [_one_of(study, effects[0], decision.equivalent, 1.0 - _something_else(study))]
    shown = [_shown(study, evident) for evident in study.shown]
    candidates = [*(_seen(study, evident) for evident in study.shown), *candidates]
    pairs = [list(pair) for pair in decision.rival_pairs]
    if decision.equivalent and decision.chosen is not None:  # the members of the set and no others
        own = decision.chosen.hypotheses[0].record.id
        pairs = [[own, other] for other in effects[0].siblings if other != own]
    days = _days(study)
    found = Diagnosis(
        verdict=verdict,
        moved=_moved(study),
        location=_location(study),
        effects=[*shown, *effects],
        candidates=candidates,
        fit=_fit(study),
        indistinguishable=pairs,
        next_experiment=_next(study),
        summary=_by_day_in_words(study, days)
        + _device_in_words(study)
        + _shown_in_words(study, shown)
        + _summary(study, effects, pairs),
        limits=[
            *limits_in_words(study.reading.findings),
            *_by_recording(study),
            *_mimics(study),
            *_even_parts(study),
            *_in_place_of_constants(study),
            *_sure(study),
            *_scattered_ends(study),
            *_swings(study),
        ],
        not_excited=list(study.search.not_excited) if verdict != "agrees" or study.reading.first_use else [],
        excess=_excess(study),
        seconds=study.seconds,
        decision_limits=study.limits.with_provenance(),
        adequacy=_adequacy(study),
        own_misfit=_own_misfit(study),
        recordings=days,
    )
    return in_own_names(found, study)


def _next(study: Study) -> NextExperiment | None:
    """What to record next: what was decided, unless nothing describes what is left, or the recordings cover too little."""
    decision = study.decision
    if decision.unnamed is not None and decision.chosen is None and not _described(study):
        return without_explanation((), decision.rivals[0].hypotheses if decision.rivals else ())
    if decision.proposal is not None or decision.verdict == "differs" or not _covers_little(study):
        return decision.proposal
    part = study.located.problem.parts[0]
    return to_cover(study.located.nominal.device, part.dt, f"The recordings cover {_extent(study)}")


def _described(study: Study) -> tuple[Shape, ...]:
    """The functions that describe what has no name; none where they predict less of it than counts."""
    unnamed = study.decision.unnamed
    return unnamed.shapes if unnamed is not None and unnamed.share >= study.limits.share else ()


def _covered(study: Study) -> float:
    """Share of the operating range that the drive went over, in any recording."""
    low, high = sorted(study.located.problem.nominal.model.description.operating_range)
    reached, total = low, 0.0
    for first, last in sorted(
        (part.current.min(), part.current.max()) for part in study.located.problem.parts
    ):
        total += max(min(last, high) - max(first, reached), 0.0)
        reached = max(reached, last)
    return float(total / (high - low))


def _covers_little(study: Study) -> bool:
    return study.reading.one_loop or _covered(study) < study.limits.narrow


def _extent(study: Study) -> str:
    """What the recordings cover, in words."""
    loop = ", on one and the same loop" if study.reading.one_loop else ""
    return f"{100 * _covered(study):.0f} % of the operating range{loop}"


def _only_covered(study: Study) -> str:
    """Say of what recordings agree with the simulation where they cover little of the device."""
    if not _covers_little(study):
        return ""
    return f" in what the recordings cover, {_extent(study)} (what the rest would show is not known)"


def in_own_names(found: Any, study: Study) -> Any:
    """Return a record, a mapping, a list or a text in which each channel has the name that the device's file gives it.

    Parameters
    ----------
    found : that has their roles, as the shipped devices call them, in texts and keys
    study : of the device
    """
    description = study.located.problem.nominal.model.description

    def own(value: Any) -> Any:
        if isinstance(value, str):
            return description.in_own_names(value)
        if isinstance(value, Mapping):
            return {own(key): own(entry) for key, entry in value.items()}
        if isinstance(value, list):
            return [own(entry) for entry in value]
        if is_dataclass(value) and not isinstance(value, type):
            return replace(value, **{f.name: own(getattr(value, f.name)) for f in fields(value)})
        return value

    return own(found)


def _adequacy(study: Study) -> dict[str, float | list[str]]:
    found = study.decision.adequacy
    if found is None:
        return {}
    ids = [key.partition(":")[0] for key in found.keys]
    told: dict[str, float | list[str]] = {"of": ids, "explained": found.share, "left": found.left}
    return told | ({"sigmas": found.sigmas} if np.isfinite(found.sigmas) else {})


def _own_misfit(study: Study) -> dict[str, dict[str, float]]:
    return {
        channel: {
            "level": float(shape.misfit.level),
            "travel_k": float(shape.misfit.travel),
            "left_out": float(shape.left_out),
        }
        for channel, shape in study.located.problem.shapes.items()
    }


def _moved(study: Study) -> list[MovedConstant]:
    """Constants that have moved, surest first."""
    sets = _sets_of_moved(study)
    return _told_moves(study, sets[0]) if sets else []


def _sets_of_moved(study: Study) -> list[Drift]:
    """The fewest constants that explain what all together do, and other sets of as many that are not told from them."""
    drift = study.decision.drift
    if study.decision.verdict == "agrees" or not drift.significant(study.limits.drift_p):
        return []
    return drift.fewest(study.limits.drift_p, study.limits.rival)


def _told_moves(study: Study, drift: Drift) -> list[MovedConstant]:
    """The moves of a drift as they are told, surest first."""
    drift = drift.of_each_recording(study.limits.constant_moved)
    return [
        MovedConstant(
            c.name,
            c.value,
            c.value + float(drift.move[k]),
            float(drift.std[k]),
            _unit(c.unit, study),
            study.located.problem.parts[c.part].name if c.part is not None else "",
        )
        for k, c in ((k, drift.constants[k]) for k in np.argsort(-drift.sigmas))
    ]


def _unit(unit: str, study: Study) -> str:
    """A unit of the chain, whose drive is in A and whose tip response is in m, in those of the device."""
    device = study.located.problem.nominal.model.description
    own = {"A": device.drive_unit, "m": device.units.get(TIP_DEFLECTION, "m")}
    return re.sub("[A-Za-z]+", lambda part: own.get(part[0], part[0]), unit)


def _moved_in_words(study: Study, moved: Sequence[MovedConstant]) -> str:
    return ", ".join(
        f"{m} from {m.was:.5g} to {m.now:.5g} +- {m.std:.2g}{'' if m.unit == '1' else ' ' + m.unit}"
        + _as_drive(study, m)
        for m in moved
    )


def _as_drive(study: Study, moved: MovedConstant) -> str:
    """What a move is on a device without body, whose temperature is but a scale of its drive."""
    model = study.located.problem.nominal.model
    gain, square = (model.scalars[f"thermal.{name}_gain"] for name in ("linear", "square"))
    if model.description.has_body or square or not gain:
        return ""
    if moved.constant == "thermal.ambient":
        return f" (as if the drive were {(moved.now - moved.was) / gain:+.3g} {model.description.drive_unit} off)"
    of = {
        "thermal.linear_gain": "the drive",
        "deflection.gain": TIP_DEFLECTION,
        "resistance.gain": RESISTANCE,
    }
    what = of.get(moved.constant)
    return f" ({what} is {moved.now / moved.was:.4g} times what it was)" if what and moved.was else ""


def _or_effects(study: Study) -> str:
    """Which effects would look much like the constants that have moved, as a sentence; empty for none."""
    names = " or ".join(h.record.id for h in study.decision.mimics)
    return f" {names} acting all the time would look much the same." if names else ""


def _mimics(study: Study) -> list[str]:
    """What would look much like the constants that have moved: effects, other constants, and another unit."""
    effects = _or_effects(study).strip().rstrip(".")
    return [
        *([f"constants have moved; {effects}"] if effects else []),
        *moved_in_place(study),
        *_powers_of_ten(_moved(study), study.limits),
    ]


def _powers_of_ten(moved: Sequence[MovedConstant], limits: Limits) -> list[str]:
    """Gains that have moved by a power of ten, which is a unit or a range of an amplifier."""
    told = []
    for m in moved:
        decades = np.log10(m.now / m.was) if m.constant.endswith("gain") and m.was * m.now > 0.0 else 0.0
        if round(decades) and abs(decades - round(decades)) < limits.decade:
            told.append(
                f"{m} is {10 ** round(decades):g} times what it was: check the unit, or an amplifier's range"
            )
    return told


def moved_in_place(study: Study) -> list[str]:
    """Return the sentence of which constants may have moved in place of those that are told; none where no others may.

    Parameters
    ----------
    study : what the stages found
    """
    sets = [" with ".join(str(m) for m in _told_moves(study, drift)) for drift in _sets_of_moved(study)]
    if len(sets) < 2:
        return []
    *others, last = sets[1:OTHERS] if len(sets) <= OTHERS else [*sets[1:OTHERS], "others"]
    names = f"{', '.join(others)} or {last}" if others else last
    return [f"{names} may have moved in place of {sets[0]}"]


def _even_parts(study: Study) -> list[str]:
    """Beside a course: that what is even in it may be something else."""
    chosen = study.decision.chosen
    told = []
    for index, hypothesis in enumerate(chosen.hypotheses if chosen else ()):
        if chosen and hypothesis.key in chosen.courses:
            values, unit = course_of(study, chosen, index)
            begins = ", ".join(f"{each[0]:.3g}" for each in values)
            told.append(
                f"{hypothesis.record.id} begins at {begins} {unit}: the even part of a course may be a constant that has moved, "
                "or what acts all the time"
            )
    return told


def _in_place_of_constants(study: Study) -> list[str]:
    """Beside a name that stands in the place of moved constants: which these are."""
    held = study.decision.held
    if held is None:
        return []
    fewest = held.drift.fewest(study.limits.drift_p, study.limits.rival)[0]
    moves = _moved_in_words(study, _told_moves(study, fewest))
    return [
        f"constants may have moved in place of the answer ({moves}): it is ahead of them by {held.ahead:.0f} of chi-square, with "
        "what each constant and parameter costs"
    ]


def _sure(study: Study) -> list[str]:
    """Beside agreement or moved constants: effects that surely act and leave more than a name may."""
    found = study.decision.adequacy
    if study.decision.verdict == "differs" or found is None or not study.limits.sure < found.sigmas < np.inf:
        return []
    names = " with ".join(key.partition(":")[0] for key in found.keys)
    return [
        f"{names} would explain {100 * found.share:.0f} % of the excess, by {found.sigmas:.0f} standard deviations, but leaves "
        "more than a name may: the fitted loops' own misfit, or something else; a calibration with loops like these would tell"
    ]


def _nearest_name(study: Study) -> str:
    """What is said where nothing is named: what would explain most of it, if anything surely does."""
    found, limits = study.decision.adequacy, study.limits
    if found is None or found.share < limits.most_of_it or not limits.sure < found.sigmas < np.inf:
        return "Nothing known explains it"
    names = " with ".join(key.partition(":")[0] for key in found.keys)
    more = found.something_else(limits) >= limits.doubt
    return (
        f"No name is sure: {names} would explain {100 * found.share:.0f} % of the excess, by {found.sigmas:.0f} standard "
        f"deviations, but {'leaves more than a name may' if more else 'others fit as well, or it is worse on held-out parts'}"
    )


def _share_of_family(study: Study, family: str) -> str:
    """How many of a set are of its family, in words."""
    families = _families_of(study, study.decision.equivalent)
    own = families.count(family)
    if own == len(families):
        return "All are"
    return "Most are" if own > study.limits.likelier * len(families) else "The likeliest is"


def _excess(study: Study) -> dict[str, float]:
    return {
        **{c: float(v) for c, v in study.located.excess.items()},
        "total": float(study.located.total_excess),
    }


def _fit(study: Study) -> dict[str, ChannelFit]:
    if study.decision.judged is None:
        return {}
    span, problem, judged = study.located.nominal.span, study.located.problem, study.decision.judged
    before, after, floor = dict(judged.as_fitted), dict(judged.after), dict(judged.floor)
    left = left_by_the_answer(study)
    if study.decision.unnamed is not None and study.decision.chosen is None:
        for row in problem.rows:
            plain = problem.in_its_unit(row, left)
            use = problem.weight[row.where] > 0
            after[row.channel] = float(np.sqrt(np.mean(plain[use] ** 2)))
    for one in study.reading.evident:
        c, share = one.signal, one.share
        if "step" in one.values:
            gain = _gain_of(study, one, left)
            after[c] = float(np.sqrt(max(after[c] ** 2 - gain, 0.0)))
            floor[c] = max(floor[c], _rounded(study, one, left)[1])
        elif not _is_limit(one):  # it was taken out of what was judged
            before[c] = float(np.sqrt(max(before[c] ** 2 + _gain_of(study, one, left), 0.0)))
        else:  # at a limit no sample was judged
            before[c], after[c] = (
                float(np.sqrt((1.0 - share) * elsewhere**2 + share * there**2))
                for elsewhere, there in ((before[c], one.before), (after[c], one.after))
            )
    return {c: ChannelFit(before[c] / span[c], after[c] / span[c], floor[c] / span[c]) for c in before}


def left_by_the_answer(study: Study) -> Floats:
    """Return what the answer leaves of the recordings, (N,) whitened, the nuisance model taken out.

    Parameters
    ----------
    study : of the recordings
    """
    decision, problem = study.decision, study.located.problem
    if decision.chosen is not None:
        return decision.final.apply_inverse_covariance(decision.final.residual - decision.chosen.deviation)
    left = problem.apply_inverse_covariance(problem.residual)
    return left - decision.unnamed.prediction if decision.unnamed is not None else left


def _is_limit(one: Evident) -> bool:
    """Whether values end somewhere, in the place of having steps or swinging."""
    return "step" not in one.values and "line" not in one.record.hooks


def _gain_of(study: Study, one: Evident, left: Floats) -> float:
    """By how much the squared error of a channel is less with what its values show."""
    gain = one.share * (one.before**2 - one.after**2)  # of a simulation that was not refitted
    return max(gain, _rounded(study, one, left)[0] if "step" in one.values else 0.0)


def _rounded(study: Study, one: Evident, left: Floats) -> tuple[float, float]:
    """By how much the squared error of a channel is less once the simulation's values are rounded too, and its noise then.

    Two values that differ by noise of standard deviation s are rounded apart by a step with the probability of s / step: the
    noise of their difference is sqrt(step s sqrt(2 / pi)) where the steps are coarse, sqrt(s^2 + step^2 / 6) where they are fine.
    """
    problem, size = study.decision.final, one.values["step"]
    gains, steps = [], []
    for row, part, _ in problem.iterate():
        use = problem.weight[row.where] > 0
        if row.channel == one.signal and np.any(use):
            seen, plain = part.observed[row.channel][use], problem.in_its_unit(row, left)[use]
            simulated = seen - plain
            if one.signal == RESISTANCE:
                rounded = np.log10(np.maximum(size * np.round(10.0**simulated / size), 0.5 * size))
                steps.append(size / (np.log(10.0) * 10.0**simulated))
            else:
                rounded = size * np.round(simulated / size)
                steps.append(np.full(seen.size, size))
            gains.append(plain**2 - (seen - rounded) ** 2)
    if not gains:
        return 0.0, 0.0
    step, noise = np.concatenate(steps), study.located.nominal.noise[one.signal].level
    level = np.minimum(step * noise * np.sqrt(2.0 / np.pi), noise**2 + step**2 / 6.0)
    return float(np.mean(np.concatenate(gains))), float(np.sqrt(np.mean(level)))


def excess_by_channel(study: Study) -> list[Breakdown]:
    """Return how the excess of each channel that `location` names is spread; of what values show, what that changes.

    Parameters
    ----------
    study : of the recordings
    """
    problem = study.located.problem
    places = {place.signal for place in _location(study)}
    found = [b for b in study.decision.breakdown if b.excess > 0 and b.channel in places]
    noise = {c: noise.scaled(QUIET) for c, noise in problem.nominal.noise.items()}
    quiet = replace(problem.nominal, noise=noise)  # on average over a noise a converter may do nothing
    for one in study.reading.evident:
        if one.signal not in {b.channel for b in found}:
            plain, changed = (
                [quiet.respond(p.current, p.dt, effects=given, settled=p.settled) for p in problem.parts]
                for given in (None, one.effects)
            )
            spread = breakdown(problem, problem.stack(changed, plain), floor=0.0)
            found += [b for b in spread if b.channel == one.signal and b.excess > 0]
    return found


def _explanations(study: Study) -> tuple[list[Explanation], Floats]:
    """The answer and its rivals, and their weights beside each other, which sum to one."""
    everyone = list(study.decision.rivals)
    if study.decision.chosen is not None:
        everyone = [
            study.decision.chosen,
            *(r for r in everyone if set(r.keys) != set(study.decision.chosen.keys)),
        ]
    # about the best explanation chi-square is lower than about the nominal simulation: compare like with like
    chi = [e.chi_square for e in everyone]
    if study.decision.chosen is not None:
        same = [r for r in study.decision.rivals if set(r.keys) == set(study.decision.chosen.keys)]
        if same:
            chi[0] = (
                min(chi[0], same[0].chi_square) if len(study.decision.chosen.keys) > 1 else same[0].chi_square
            )
    return everyone, _weights(study, everyone, chi) if everyone else np.zeros(0)


def _candidates(study: Study) -> tuple[list[Candidate], dict[str, float]]:
    """Candidates with probabilities, and the probability of each key."""
    everyone, weights = _explanations(study)
    if not everyone:
        return [], {}
    otherwise = _something_else(study)
    certain = 1.0 - otherwise
    by_key: dict[str, float] = {}
    best: dict[str, Explanation] = {}
    for weight, explanation in zip(weights, everyone, strict=True):
        for key in explanation.keys:
            by_key[key] = by_key.get(key, 0.0) + float(weight) * certain
            best.setdefault(key, explanation)
    together = set(study.decision.equivalent)
    if (
        together
        and study.reading.first_use
        and study.decision.chosen is not None
        and study.decision.chosen.courses
    ):
        # told as one of several without a comparison: none of them is likelier
        members = [key for key in by_key if key in together]
        by_key |= dict.fromkeys(members, sum(by_key[key] for key in members) / len(members))
    size = {c: study.located.nominal.span[c] for c in study.located.excess}
    told = 0.0 if study.decision.chosen is None else _share(study, study.decision.chosen.gain)
    found: list[Candidate] = []
    of_each = {id(e): float(w) for w, e in zip(weights, everyone, strict=True)}
    for key, probability in sorted(by_key.items(), key=lambda item: -item[1]):
        explanation = best[key]
        name, _, signal = key.partition(":")
        gained = _share(study, explanation.gain)
        own = key in study.decision.chosen.keys if study.decision.chosen else False
        nrmse = {}
        for c in study.located.excess:
            reached = study.decision.judged.after.get(c, 0.0) if study.decision.judged else 0.0
            if not own:  # from the answer's own error, by how much more of the excess would be left
                left, answer = (max(1.0 + study.located.excess[c] * (1.0 - g), 1.0) for g in (gained, told))
                reached *= float(np.sqrt(left / answer))
            nrmse[c] = reached / size[c]
        found.append(
            Candidate(
                name,
                min(probability, 1.0),
                nrmse,
                signal or None,
                explained_share=gained,
                why_not=f"one of the set that is the answer; explains {100 * gained:.0f} % of the excess"
                if key in together
                else ""
                if own
                else _why_not(
                    study, explanation, of_each[id(explanation)] / max(of_each[id(everyone[0])], TINY)
                ),
            )
        )
    left = float(np.clip(1.0 - told, 0.0, 1.0))
    after = study.decision.judged.after
    unknown = Candidate(
        "unknown",
        otherwise,
        {c: after.get(c, 0.0) / size[c] for c in study.located.excess},
        explained_share=left,
        why_not=f"something that is in no catalogue; the answer leaves {100 * left:.0f} % of the excess"
        if study.decision.chosen
        else "",
    )
    return sorted([*found[:11], unknown], key=lambda c: -c.probability), by_key


def equally_likely(study: Study) -> tuple[str, ...]:
    """Return the keys of the effects of which the answer is one, likeliest first; none where one of them can be named.

    A single name must be more likely than everything else together. Where none is, but an effect of the catalogue is likelier
    than something that is in none, the fewest effects that hold most of the probability are told in its place. On a device
    without body those that explain as much are told, unless one holds most of the probability by itself, and those that give
    the same values.

    Parameters
    ----------
    study : what the stages found
    """
    chosen = study.decision.chosen
    if chosen is None or len(chosen.keys) > 1:
        return study.decision.equivalent
    probability = _candidates(study)[1]
    if not study.located.problem.nominal.model.description.has_body:
        alone = probability[chosen.keys[0]] > study.limits.credible
        others = () if alone else study.decision.equivalent
        records = {h.key: h.record for h in study.search.candidates}
        told = others or chosen.keys
        same = [other for key in told for other in records[key].same_values]
        return (*told, *same) if same else others
    if probability[chosen.keys[0]] > study.limits.likelier or _something_else(study) >= study.limits.likelier:
        return ()
    order = sorted(probability, key=lambda key: (-probability[key], key != chosen.keys[0]))
    held = np.cumsum([probability[key] for key in order])
    most = order[: int(np.searchsorted(held, study.limits.credible * held[-1])) + 1]
    return tuple(most) if len({key.partition(":")[0] for key in most}) > 1 and chosen.keys[0] in most else ()


def _in_its_place(study: Study, key: str) -> dict[str, float]:
    """Probability of each effect of one family in the place of one of two that are named together, whatever the other is.

    What a channel's sensor and its clock do is one family here.

    Parameters
    ----------
    study : whose answer is two effects
    key : of one of them
    """
    every = {h.key: h for h in study.search.candidates}
    own = {name: every[name].record.family(every[name].signal).replace("clock:", "sensor:") for name in every}
    (beside,) = (other for other in study.decision.chosen.keys if other != key)  # type: ignore[union-attr]
    everyone, weights = _explanations(study)
    found: dict[str, float] = {}
    for explanation, weight in zip(everyone, weights, strict=True):
        same = [other for other in explanation.keys if own.get(other) == own.get(key) and other != beside]
        if same:
            name = key if key in same else same[0]
            found[name] = found.get(name, 0.0) + float(weight) * (1.0 - _something_else(study))
    return found


def one_of_family(study: Study) -> dict[str, tuple[str, ...]]:
    """Return which of two effects that are named together is but one of its family, and the fewest that hold most of its place.

    Parameters
    ----------
    study : what the stages found

    Returns
    -------
    key of the effect -> keys of those of which it is one, likeliest first; empty where each of the two has a name
    """
    chosen = study.decision.chosen
    if chosen is None or len(chosen.keys) != 2:
        return {}
    found = {}
    for key in chosen.keys:
        place = _in_its_place(study, key)
        order = sorted(place, key=lambda name, of=place: -of[name])  # type: ignore[misc]
        held = np.cumsum([place[name] for name in order])
        most = order[: int(np.searchsorted(held, study.limits.credible * held[-1])) + 1]
        if (
            place[key] < study.limits.likelier <= held[-1]
            and len({name.partition(":")[0] for name in most}) > 1
        ):
            found[key] = tuple(most)
    return found


def _likelihood_of_each(study: Study) -> list[float]:
    """Probability of each effect that is named; of two, that of its family in its place beside the other."""
    chosen = study.decision.chosen
    if chosen is not None and len(chosen.keys) == 2:
        return [sum(_in_its_place(study, key).values()) for key in chosen.keys]
    probability = _candidates(study)[1]
    return [probability[key] for key in chosen.keys] if chosen is not None else []


def doubts_one_of_two(study: Study) -> bool:
    """Return whether one of two effects that are named together is less likely than not: others would do in its place.

    Those of the same family count with it: that something of this kind acts is not in doubt where its members are not told apart.

    Parameters
    ----------
    study : what the stages found
    """
    chosen = study.decision.chosen
    return (
        chosen is not None
        and len(chosen.keys) > 1
        and min(_likelihood_of_each(study)) < study.limits.likelier
    )


def unlikely(study: Study) -> bool:
    """Return whether something else than what is named is more likely than a name.

    On a device with a body that is what is in no catalogue: a rival of the name is told beside it, with the experiment
    that separates them. On a device without body, whose own misfit is the yardstick, no rival is told; there a name
    stands for itself and must be more likely than everything else together.

    Parameters
    ----------
    study : what the stages found
    """
    if study.decision.chosen is None:
        return False
    if study.decision.equivalent:
        return _something_else(study) >= study.limits.likelier
    least = min(_likelihood_of_each(study))
    if not study.located.problem.nominal.model.description.has_body:
        return least <= study.limits.likelier
    return least < _something_else(study)


def _weights(study: Study, everyone: Sequence[Explanation], chi: Sequence[float]) -> Floats:
    """Return the weights of explanations beside each other, which sum to one.

    One effect in the place of another: by how surely the blocks of the recordings prefer it, see `odds_of_rival`. Of pairs,
    and where nothing is named: by chi-square, tempered.
    """
    problem, chosen = _judged_against(study), study.decision.chosen
    temper = study.limits.temper * (1.0 + max(study.decision.remaining_excess, 0.0))
    if study.reading.one_loop and chosen is not None:
        on_one_loop = study.limits.temper_on_one_loop * behind_the_loop(problem, chosen.gain)
        if not problem.nominal.model.description.has_body:
            left = 1.0 + max(study.decision.remaining_excess, 0.0)
            on_one_loop = min(on_one_loop, problem.count / study.limits.samples_of_one_loop * left)
        temper = max(temper, on_one_loop)
    costs = np.array(
        [cost(replace(e, chi_square=q), problem, study.limits) for e, q in zip(everyone, chi, strict=True)]
    )
    weights = probabilities(costs, temper=temper)
    if chosen is None or len(chosen.keys) > 1:
        return weights
    same = next((r for r in study.decision.rivals if r.keys == chosen.keys), None)
    if same is None:
        return weights
    change = _change(problem, same)
    dearer = costs - np.array(chi)

    def odds_of(place: int) -> float:
        other = _change(problem, everyone[place])
        if not _holds(study, everyone[place], other):
            return 0.0
        more, worse = dearer[place] - dearer[0], chi[place] - chi[0]
        return odds_of_rival(problem, change, other, dearer=more, worse=worse)

    # a fit about itself may be far beyond what the simulation is linear over here: its chi-square is all that counts then
    places = range(1, len(everyone))
    odds = parallel_map(odds_of, places) if _holds(study, same, change) else [0.0 for _ in places]
    return beside_the_first(weights, odds)


def _judged_against(study: Study) -> LinearisedProblem:
    """The problem without effects that the answer is told against: constants held where it stands in their place."""
    held = study.decision.held
    return study.located.problem if held is None else held.reference


def _change(problem: LinearisedProblem, explanation: Explanation) -> Floats:
    """Return the whitened change (N,) from the simulation without effects: some were fitted about themselves."""
    if explanation.courses:
        return explanation.deviation
    shift = np.pad(explanation.shift, (0, problem.origin.size - explanation.shift.size))
    return problem.deviation(explanation.effects, shift)


def _holds(study: Study, explanation: Explanation, change: Floats) -> bool:
    """Whether a change (N,) of the simulation leaves here what its explanation leaves where it was fitted, or not much more."""
    problem = _judged_against(study)
    return problem.chi_square(problem.residual - change) < study.limits.left_here * explanation.chi_square


def _something_else(study: Study) -> float:
    """Return the probability that nothing of the catalogue is the answer.

    A logistic function of how surely the best explanation acts and of what it leaves; at least one half where it is not named.
    Where there is none it is one, less half of what the best single effect explains. Unless the values themselves show an effect,
    no answer is told surer than answers of that kind have been right.
    """
    adequacy, least = study.decision.adequacy, study.limits.else_least
    if adequacy is None:
        return min(1.0 - 0.5 * _best_share(study), 1.0 - least)
    otherwise = adequacy.something_else(study.limits)
    held = study.decision.held
    if held is not None:  # or constants have moved after all
        temper = study.limits.temper * (1.0 + max(study.decision.remaining_excess, 0.0))
        otherwise = 1.0 - (1.0 - otherwise) / (1.0 + float(np.exp(-0.5 * held.ahead / temper)))
    otherwise = otherwise if study.decision.chosen is not None else max(otherwise, study.limits.likelier)
    return min(max(otherwise, least), 1.0 - least) if np.isfinite(adequacy.sigmas) else otherwise


def _best_share(study: Study) -> float:
    """Return the share of the excess that the best single effect explains, 0 to 1."""
    best = max((e.gain for e in study.search.singles), default=0.0)
    return float(
        np.clip(best / max(study.located.problem.count * study.located.total_excess, 1e-9), 0.0, 1.0)
    )


def _share(study: Study, gain: float) -> float:
    """Return the share of the excess that a gain is, 0 to 1.

    Where the nuisance model has moved its constants to follow an effect, little or no excess is left to compare with: there the
    share is of the most that any effect explains.
    """
    known = [
        *study.search.singles,
        *study.decision.rivals,
        *([study.decision.chosen] if study.decision.chosen else []),
    ]
    whole = max([study.located.problem.count * study.located.total_excess, *(e.gain for e in known)])
    return float(np.clip(gain / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def _why_not(study: Study, explanation: Explanation, odds: float) -> str:
    """Why a rival is not the answer; `odds` against what is named, as the probabilities have them."""
    gained = _share(study, explanation.gain)
    if study.decision.chosen is None:
        return f"explains {100 * gained:.0f} % of the excess, which is not enough to name it"
    if explanation.at_bound:
        return f"its fit ends at a physical bound ({', '.join(explanation.at_bound)})"
    likely = f"{odds:.2g} times" if odds > RARELY else f"less than {RARELY:g} times"
    against = "the likeliest of the set" if study.decision.equivalent else "the answer"
    return f"explains {100 * gained:.0f} % of the excess; {likely} as likely as {against}"


def _location(study: Study) -> list[Location]:
    """Where recording and simulation differ."""
    decision = study.decision
    places = [] if decision.verdict == "agrees" else locate(decision.final, decision.breakdown, study.limits)
    if not study.reading.evident:
        return places
    return located_with(study.reading.evident, places, sum(max(b.excess, 0.0) for b in decision.breakdown))


def _shown(study: Study, evident: Evident) -> NamedEffect:
    """An effect that the values show by themselves, its parameters as exact as they are written."""
    description, record = study.located.problem.nominal.model.description, evident.record
    units = {p.name: description.own_unit(p.unit, evident.signal) for p in record.parameters}
    return NamedEffect(
        record.id,
        study.limits.seen,
        record.statement,
        record.equation,
        {
            name: Estimate(value, evident.deviations.get(name, EXACT * abs(value)), units[name])
            for name, value in evident.values.items()
        },
        evident.signal,
        record.family(evident.signal),
        "shown by the values themselves",
    )


def _seen(study: Study, evident: Evident) -> Candidate:
    """The same as a candidate: what it explains is told for the samples at which it acts."""
    size = study.located.nominal.span[evident.signal]
    return Candidate(
        evident.record.id,
        study.limits.seen,
        {evident.signal: evident.after / size},
        evident.signal,
        explained_share=evident.explained,
    )


def _shown_in_words(study: Study, shown: Sequence[NamedEffect]) -> str:
    """What the values show, a sentence for each effect, before what is said of everything else."""
    words, fit, left = "", _fit(study), left_by_the_answer(study)
    for evident, effect in zip(study.shown, shown, strict=True):
        told = ", ".join(f"{name} {p.value:.5g} {p.unit}" for name, p in effect.parameters.items())
        size = study.located.nominal.span[evident.signal]
        before, after = evident.before / size, evident.after / size
        if evident.signal in fit and not _is_limit(evident):  # as the table has it
            after = fit[evident.signal].nrmse_after
            before = float(np.sqrt(max(after**2 + _gain_of(study, evident, left) / size**2, 0.0)))
        words += (
            f"The values of {evident.signal} show "
            f"{effect.id} by themselves ({told}; {100 * evident.share:.3g} % of the samples): left out; without it the error "
            f"there is {100 * before:.3g} % of the range, with it {100 * after:.3g} %. "
        )
    return words + ("Beside it: " if words and study.decision.verdict != "agrees" else "")


def _had_before(study: Study, hypothesis: Hypothesis) -> str:
    """What the model has of an effect already, in words; empty where it has none of it."""
    model = study.located.problem.nominal.model
    fitted = []
    for name, value in model.effects.get(hypothesis.key, {}).items():
        if name != "signal":
            unit = model.description.own_unit(hypothesis.parameter(name).unit, hypothesis.signal)
            fitted.append(f"{name} {float(value):.4g}" + ("" if unit == "1" else f" {unit}"))
    return f" The model has it already, with {', '.join(fitted)}; here it has other values." if fitted else ""


def _named(study: Study, probability: dict[str, float]) -> list[NamedEffect]:
    found: list[NamedEffect] = []
    if study.decision.chosen is not None:
        each, sets = [], one_of_family(study)
        for index, hypothesis in enumerate(study.decision.chosen.hypotheses):
            record = hypothesis.record
            parameters = {}
            for name, value in study.decision.chosen.values[index].items():
                if name in hypothesis.switches and abs(value) >= HUGE:
                    continue  # never switched
                unit = study.located.problem.nominal.model.description.own_unit(
                    hypothesis.parameter(name).unit, hypothesis.signal
                )
                form = 0.0 if unit == CHOICE else MODEL_DISCREPANCY[record.stage]
                spread = float(np.hypot(study.decision.chosen.std(index, name), form * value))
                parameters[name] = Estimate(float(value), spread, unit)
            effect = NamedEffect(
                record.id,
                float(np.clip(probability.get(hypothesis.key, 1.0), 0.0, 1.0)),
                record.statement + _had_before(study, hypothesis),
                record.equation,
                parameters,
                hypothesis.signal or None,
                record.family(hypothesis.signal),
                _form(study, hypothesis, study.decision.chosen, index),
                [theirs for ours, theirs in study.decision.rival_pairs if ours == record.id],
            )
            if hypothesis.key in sets:
                place = _in_its_place(study, hypothesis.key)
                effect = _one_of(study, effect, sets[hypothesis.key], sum(place.values()))
            each.append((hypothesis.key, effect))
        # of two that are equally sure, the one first that explains more by itself
        alone = {e.keys[0]: e.gain for e in study.search.singles}
        each.sort(key=lambda one: (-round(one[1].probability, 2), -alone.get(one[0], 0.0)))
        found = [effect for _, effect in each]
    if study.decision.unnamed is not None or not found:
        found.append(_unknown(study))
    return found


def _one_of(study: Study, best: NamedEffect, keys: Sequence[str], probability: float) -> NamedEffect:
    """The answer where several effects explain the recordings equally well: their family, without a name, and all of them.

    The family is that of most of them, of equally many that of the best. Of one loop and its sensor no structure and no film
    can be told: what is theirs is the sensor's, see `families.OF_ONE_LOOP`.
    """
    families, equivalent = _families_of(study, keys), _ids(keys)
    return NamedEffect(
        "unknown",
        probability,
        f"One of {', '.join(equivalent)}: these recordings do not tell which it is. The probability is that of all of them "
        "together; that of something else, which is in no catalogue, stands among the candidates as unknown. "
        f"The corrected model carries {best.id}, which stands for all of them.",
        f"as of {best.id}: {best.equation}",
        {},
        best.signal,
        max(families, key=families.count),
        "one of several",
        equivalent,
    )


def _families_of(study: Study, keys: Sequence[str]) -> list[str]:
    """Families of effects; of one loop and its sensor what would be a structure's or a film's is the sensor's."""
    every = {h.key: h for h in study.search.candidates}
    families = [every[key].record.family(every[key].signal) for key in keys if key in every]
    if study.located.problem.nominal.model.description.is_one_loop:
        excess = study.located.excess
        sensor = f"sensor:{max(excess, key=lambda channel: excess[channel])}"
        families = [sensor if family in ("structure", "film") else family for family in families]
    return families


def course_of(study: Study, chosen: Explanation, index: int) -> tuple[list[Floats], str]:
    """Return the amplitude of an effect that takes a course, at each sample of each recording (n,), and its unit.

    Parameters
    ----------
    study : of the recordings
    chosen : an answer
    index : of one of its hypotheses that has a course
    """
    hypothesis = chosen.hypotheses[index]
    bend, name = chosen.courses[hypothesis.key], hypothesis.record.course
    rate = chosen.values[index].get(name, 0.0)
    values = [
        rate * part.dt * np.arange(1, part.size + 1) + bend.amplitude(place, part.size, part.size * part.dt)
        for place, part in enumerate(study.located.problem.parts)
    ]
    description = study.located.problem.nominal.model.description
    unit = description.own_unit(hypothesis.parameter(name).unit, hypothesis.signal).removesuffix("/s")
    return ([100.0 * each for each in values], "%") if unit == "1" else (values, unit)


def _ids(keys: Sequence[str]) -> list[str]:
    """Ids of effects, each once."""
    return list(dict.fromkeys(key.partition(":")[0] for key in keys))


def _form(study: Study, hypothesis: Hypothesis, chosen: Explanation, index: int) -> str:
    """What an effect does, by the first sentence of its record, and which of its forms it has where it has a choice."""
    words = [
        hypothesis.record.statement.partition(". ")[0].rstrip(".") or hypothesis.record.id.replace("_", " ")
    ]
    if hypothesis.key in chosen.courses:
        values, unit = course_of(study, chosen, index)
        low, high = min(each.min() for each in values), max(each.max() for each in values)
        words.append(f"any slow course in time from {low:.3g} to {high:.3g} {unit}")
    for name, value in chosen.values[index].items():
        parameter = hypothesis.parameter(name)
        if name in hypothesis.choices:
            words.append(f"{name} {value:g} ({parameter.description})")
        elif name in hypothesis.switches:
            words.append(f"{name} never" if abs(value) >= HUGE else f"{name} at {value:.4g} s")
    return "; ".join(words)


def _unknown(study: Study) -> NamedEffect:
    outside = study.decision.unnamed
    shapes = _described(study)
    if shapes:
        words = "; ".join(
            f"{s.channel} depends on {s.words} ({100 * s.share:.0f} % of its excess)" for s in shapes[:4]
        )
        statement = (
            "Nothing of the catalogue explains the excess. A correction without a name removes "
            f"{100 * outside.share:.0f} % of it on blocks it was not fitted on: {words}."  # type: ignore[union-attr]
        )
        equation = " + ".join(f"f({s.group}) in {s.channel}" for s in shapes[:4])
    else:
        statement = (
            "The residual exceeds the noise, but neither an effect of the catalogue explains it nor does a smooth function of "
            f"time, temperature, rate, current or memory predict {100 * study.limits.share:.0f} % of it on blocks it was not "
            "fitted on."
        )
        equation = "none found"
    named = sum(1.0 for _ in (study.decision.chosen.hypotheses if study.decision.chosen else ()))
    probability = 1.0 if not named else 0.5
    if study.decision.chosen is None:
        probability = _something_else(study)
    swings = [one for one in study.reading.evident if study.is_part_of_the_unnamed(one)]
    # what swings in one channel alone is of its sensor
    family = (
        swings[0].record.family(swings[0].signal)
        if swings
        else _family_of_the_best(study)
        or family_of_unnamed(
            study.located.problem, study.located.excess, outside.shapes if outside is not None else ()
        )
    )
    form = shapes[0].words if shapes else "none found"
    return NamedEffect("unknown", float(probability), statement, equation, {}, family=family, form=form)


def _family_of_the_best(study: Study) -> str:
    """The family of a single effect that explains more of what has no name than any of another family; empty for none."""
    if study.decision.chosen is not None or not study.located.problem.nominal.model.description.has_body:
        return ""
    best: dict[str, float] = {}
    for one in study.search.singles:
        (hypothesis,) = one.hypotheses
        family = hypothesis.record.family(hypothesis.signal)
        best[family] = max(best.get(family, 0.0), _share(study, one.gain))
    first, second, *_ = [*sorted(best.items(), key=lambda item: -item[1]), ("", 0.0), ("", 0.0)]
    clear = first[1] >= study.limits.likelier and first[1] - second[1] >= study.limits.clear_family
    return first[0] if clear else ""


def _by_recording(study: Study) -> list[str]:
    """The excess of each recording where there are several, and whether they contradict each other."""
    problem = study.located.problem
    if len(problem.parts) < 2:
        return []
    left = problem.apply_inverse_covariance(problem.residual)
    energy, count = np.zeros(len(problem.parts)), np.zeros(len(problem.parts))
    for row in problem.rows:
        rest = left[row.where]
        energy[row.part] += float((rest if problem.refits else problem.residual[row.where]) @ rest)
        count[row.part] += float(np.count_nonzero(problem.weight[row.where]))
    # what is fitted to all of them together may leave less than nothing in one
    excess = np.maximum(energy / np.maximum(count, 1.0), 0.0) - 1.0
    told = ", ".join(f"{part.name} {value:.3g}" for part, value in zip(problem.parts, excess, strict=True))
    text = f"excess in noise powers by recording: {told}"
    if excess.max() > study.limits.one_by_one * max(excess.min(), study.limits.excess):
        text += "; some differ and others do not: diagnose them one by one"
    return [text]


def _days(study: Study) -> list[RecordingAnswer]:
    """The answer of each recording, where not all have the same."""
    told = {id(one): assemble_diagnosis(replace(one, days=())) for _, one in study.days}
    return [
        RecordingAnswer(name, own.verdict, own.effects, own.moved, _names(one))
        for name, one, own in ((name, one, told[id(one)]) for name, one in study.days)
    ]


def _by_day_in_words(study: Study, days: Sequence[RecordingAnswer]) -> str:
    """What is said of each recording, before what is said of those that the rest is of; empty where it is of all."""
    if not days:
        return ""
    own = _names(study)
    told = "; ".join(f"{day.recording} {_answer_in_words(day)}" for day in days)
    return f"Not all recordings have the same answer: {told}. All else here is of {' and '.join(own)}. "


def _answer_in_words(day: RecordingAnswer) -> str:
    """An answer in a few words, with its figures."""
    words = []
    for effect in day.effects:
        of = f"one of {', '.join(effect.siblings)}" if effect.siblings else effect.id
        on = f" on {effect.signal}" if effect.signal and not effect.siblings else ""
        figures = "".join(
            f", {name} {e.value:.4g} +- {e.std:.2g}{'' if e.unit == '1' else ' ' + e.unit}"
            for name, e in effect.parameters.items()
            if e.std
        )
        words.append(f"{of}{on} (probability {effect.probability:.2f}){figures}")
    words += [
        f"{m} from {m.was:.5g} to {m.now:.5g} +- {m.std:.2g}{'' if m.unit == '1' else ' ' + m.unit}"
        for m in day.moved
    ]
    return day.verdict + (f" ({'; '.join(words)})" if words else "")


def _names(study: Study) -> list[str]:
    return [part.name for part in study.located.problem.parts]


def _of_what(study: Study) -> str:
    """Which channels agree, where a response of the device could not be judged."""
    judged = {row.channel for row in study.located.problem.rows}
    device = study.located.problem.nominal.model.description
    absent = [response.role for response in device.responses if response.role not in judged]
    if not absent:
        return ""
    return f" in {' and '.join(sorted(judged))} ({' and '.join(absent)} could not be judged)"


def _refitted(study: Study) -> str:
    """Say that the nominal device was fitted anew, where it was."""
    return " (the nominal device fitted to all of them)" if study.reading.first_use else ""


def _taken_up(study: Study) -> str:
    """Say which effects could have been there all along unseen, where that is asked."""
    names = study.search.not_excited if study.reading.first_use else ()
    if not names:
        return ""
    return (
        f" The refitted device would take up {', '.join(names)} even where large, and others where small: whether they were "
        "there all along cannot be told."
    )


def _loops_in_words(study: Study) -> list[str]:
    """How far the loops were fitted anew, channel by channel, where they were; in per cent of the channel's range."""
    decision = study.decision
    final = decision.final
    if not final.refits:
        return []
    rest = final.residual - (decision.chosen.deviation if decision.chosen else 0.0)
    weights = final.loop_weights(final.fit_nuisance(rest))
    found = []
    for channel, columns in final.loops.items():
        change = np.concatenate([raw @ weights[channel] for raw in columns.raw])
        share = float(np.sqrt(np.mean(change**2))) / study.located.nominal.span[channel]
        found.append(f"the loop of {channel} by {100 * share:.2g} % of its range (r.m.s.)")
    return found


def _missed_by_the_law(study: Study) -> str:
    """Say how large what is taken for the misfit of the model is, where that is far above the noise; begins with a blank."""
    model = study.located.nominal.model
    if not model.description.has_body:
        return ""
    # the noise of the sensor alone: that of the diagnosis may hold what wanders slowly already
    most = max(
        (
            (shape.misfit.level / noise_level(channel, model.sensors[channel].noise), channel)
            for channel, shape in study.located.problem.shapes.items()
            if channel in model.sensors and model.sensors[channel].noise > 0.0
        ),
        default=(0.0, ""),
    )
    if most[0] <= study.limits.loud_misfit:
        return ""
    return (
        f" What the model misses of its own calibration is taken for its misfit, in {most[1]} {most[0]:.2g} times the noise: "
        "physics of that size, there all along, is not seen."
    )


def _further_than_the_calibration(study: Study) -> str:
    """Say where far more is left than noise and misfit of the calibration, though it agrees; begins with a blank.

    What changes slowly along the path of the temperature is many samples of one surprise, and weighs little.
    """
    located = study.located
    if not located.nominal.model.description.has_body:
        return ""
    ratios = {
        channel: study.decision.judged.after.get(channel, 0.0)
        / float(np.linalg.norm([located.nominal.noise[channel].level, shape.misfit.level, shape.rough]))
        for channel, shape in located.problem.shapes.items()
        if channel in located.nominal.noise
    }
    most = max(ratios, key=lambda c: ratios[c], default="")
    if not most or ratios[most] <= study.limits.far_from_calibration:
        return ""
    return (
        f" But in {most} what is left is {ratios[most]:.2g} times noise and misfit of the calibration (r.m.s.); it changes "
        "slowly, which this verdict hardly counts: loops that the law misses, or a drift. Look at the residual before you rely "
        "on it."
    )


def _why_enough(study: Study) -> str:
    """Say why an excess is no sign of physics."""
    if study.decision.as_calibrated:
        return (
            f"and in {study.decision.as_calibrated}, where most of it is, what is left is no larger (r.m.s.) than what the fit "
            "missed of parts of its calibration that it had left out"
        )
    if study.decision.unlike_noise:
        if _sure(study):
            return "and what predicts some of it leaves most: the fitted loops' own misfit"
        return (
            "and no effect of the catalogue nor any smooth function of time, temperature, rate, current or memory predicts "
            f"{100 * study.limits.share:.0f} % of it on blocks that it was not fitted on: taken for the fitted loops' own misfit"
        )
    located, limits = study.located, study.limits
    most = max(located.own_misfit.values(), default=0.0)
    if (most > 1.0 or located.is_large(limits)) and located.within_misfit(limits.unlike_misfit):
        usual = located.within_misfit(limits.own_misfit)
        judged = "as repeats may be" if usual else "more than most repeats, but no effect is adequate"
        return f"{most:.2g} times the error of the fit on held-out parts of its calibration, {judged}"
    if located.is_large(limits):
        share = 100 * located.left_out
        return f"no more than the fitted loops miss of a stretch of their calibration that was left out, {share:.0f} %"
    return "no more than an unchanged device shows"


def _floor(study: Study) -> str:
    """What the residual is measured by: noise alone, or with it what the fit missed of its own calibration."""
    nominal = study.located.nominal
    if stepped := sorted({one.signal for one in study.shown if "step" in one.values}):
        return f"the noise and the steps of {' and '.join(stepped)}"
    for channel in study.located.excess:
        sensor = nominal.model.sensors.get(channel)
        noise = sensor.noise / (np.log(10.0) if channel == RESISTANCE else 1.0) if sensor else 0.0
        if 0.0 < study.limits.misfitted * noise < nominal.noise[channel].level:
            return "noise and misfit of the calibration"
    return "the noise"


def _scattered_ends(study: Study) -> list[str]:
    """Beside a range that ends, where the values do not say so by themselves: that no converter scatters at its end."""
    chosen = study.decision.chosen
    ended = [h for h in chosen.hypotheses if h.record.id == "adc_saturation"] if chosen else []
    return [
        f"the values at the end of the range of {one.signal} scatter, and a converter at its limit gives one value: something "
        "before the noise comes in may be at its end, such as a stop that the device meets or an amplifier"
        for one in ended
    ]


def _swings(study: Study) -> list[str]:
    """Swings at one frequency that are a minor part of what has no name."""
    told = []
    for one in study.reading.evident:
        if study.is_part_of_the_unnamed(one):
            amplitude, frequency = (
                _shown(study, one).parameters[name] for name in ("amplitude", "frequency")
            )
            told.append(
                f"{one.signal} swings at {frequency.value:.4g} {frequency.unit} as well, by {amplitude.value:.3g} "
                f"{amplitude.unit}: it explains less of the channel than is left there, and is taken for a part of what has no "
                "name"
            )
    return told


def _device_in_words(study: Study) -> str:
    """What says that a recording is of another device, or is not judged in large part, before all else."""
    told = [f.text for f in study.reading.findings if f.kind in ("device", "unjudged")]
    return "".join(f"{text}. " for text in told) + _other_device(study)


def _other_device(study: Study) -> str:
    """The question of many constants that are far off at once; empty for few, or where a refit is what is looked at."""
    if study.reading.first_use:
        return ""
    model = study.located.problem.nominal.model
    warm = float(np.mean(loop_ends(model))) - model.scalars["thermal.ambient"]
    far: dict[str, None] = {}
    for m in _moved(study):
        scale = warm if m.constant == "thermal.ambient" else m.was
        if not m.constant.endswith("zero") and scale and abs((m.now - m.was) / scale) > study.limits.far_move:
            far[m.constant] = None
    most = study.limits.other_device - (study.decision.chosen is None and study.decision.verdict == "differs")
    if len(far) < most or not RESPONSE_GAINS.intersection(far):
        return ""
    return (
        f"{len(far)} constants are more than {100 * study.limits.far_move:g} % off at once ({', '.join(far)}): is it a recording "
        "of another device? "
    )


def _or_other_device(study: Study, share: float) -> str:
    """What else a large excess may be that functions of what a device goes through describe badly."""
    limits = study.limits
    if study.reading.first_use or study.located.total_excess < limits.other_loops or share > limits.described:
        return ""
    return ", as little as it would of another device"


def _summary(study: Study, effects: list[NamedEffect], pairs: list[list[str]]) -> str:
    """The answer in two or three sentences."""
    decision, excess = study.decision, study.located.excess
    power = 100 * max(study.located.total_excess, 0.0)
    if decision.verdict == "agrees":
        head = "With that simulation" if study.shown else "Simulation"
        return (
            f"{head} and recording agree{_of_what(study)}{_refitted(study)}{_only_covered(study)}: the residual exceeds "
            f"{_floor(study)} by {power:.0f} % of its power, {_why_enough(study)}.{_further_than_the_calibration(study)}"
            f"{_missed_by_the_law(study)}{_taken_up(study)}"
        )
    moved = _moved_in_words(study, _moved(study))
    if decision.verdict == "drifted":
        return (
            f"The same physics, constants have moved{_of_what(study)}: {moved}. With them simulation and recording "
            f"agree{_only_covered(study)}: the residual exceeds {_floor(study)} by {power:.0f} % of its power, "
            f"{_why_enough(study)}.{_further_than_the_calibration(study)}{_or_effects(study)}"
        )
    if decision.taken_up:
        far = max(decision.taken_up, key=lambda c: decision.taken_up[c])
        return (
            f"Simulation and recording differ, most in {far}: the model as it is misses it by {decision.taken_up[far]:.2g} times "
            "the error of the fit on held-out parts of its calibration. Moved constants and changed loops together take that up, "
            "and none of them surely: nothing is named and no constant told."
        )
    # as `location` has it, whose shares are of energy; of a short channel the power may be higher. A channel that constants
    # have taken below its noise is none in which anything differs. At first use the refitted device has taken up most of it, in
    # any channel: where the effect acts is where they differ
    acts = study.reading.first_use and decision.chosen is not None
    energy = {
        b.channel: b.excess
        for b in decision.breakdown
        if b.excess > 0.0 and (acts or excess.get(b.channel, 0.0) > 0.0)
    } or excess
    where = max(energy, key=lambda c: energy[c])
    family = effects[0].family
    head = (
        f"Simulation and recording differ, most in {where} ({_times_the_floor(study, excess[where])}, after "
        "a refit of what another day may move)."
    )
    if acts:
        head = (
            f"Simulation and recording differ, most in {where} (fitted to all of them the nominal device leaves "
            f"{_times_the_floor(study, excess.get(where, 0.0))}, which may hold a part of what is left out)."
        )
    if decision.held is not None:
        head = (
            "Simulation and recording differ: one effect, with no constant moved, explains what several constants would have to "
            "move for."
        )
    lead = (
        "The calibration had taken up a part of it"
        if study.reading.first_use
        else "Constants have moved besides"
    )
    if decision.chosen is None and not study.reading.first_use:
        lead = "The refit moved constants besides, which may stand for a part of it"
    moved = ", ".join(text for text in (moved, *_loops_in_words(study)) if text)
    tail = f" {lead}: {moved}." if moved else ""
    if decision.equivalent:
        return (
            f"{head} Left out: one of {', '.join(effects[0].siblings)}; these recordings do not tell which. "
            f"{_share_of_family(study, family)} of the family {family}.{tail}"
        )
    names = [
        (f"one of {', '.join(e.siblings)}" if e.id == "unknown" else e.id)
        + (f" on {e.signal}" if e.signal else "")
        for e in effects
        if e.id != "unknown" or e.siblings
    ]
    if not names:
        share = decision.unnamed.share if decision.unnamed else 0.0
        if share < study.limits.share:
            return (
                f"{head} {_nearest_name(study)}, and no smooth function of time, temperature, rate, current or memory "
                f"predicts {100 * study.limits.share:.0f} % of it on blocks that it was not fitted on: loops the law misses, "
                f"what is not in these recordings, another device, or noise of the rig.{tail}"
            )
        return (
            f"{head} {_nearest_name(study)}; it acts in the family {family}. A correction without a name "
            f"removes {100 * share:.0f} % of the excess{_or_other_device(study, share)}.{tail}"
        )
    whole = _judged_against(study)
    before = max(whole.residual_chi_square / whole.count - 1.0, 1e-9)
    share = 1.0 - max(decision.remaining_excess, 0.0) / before
    text = f"{head} Left out: {' and '.join(names)}, which explains {100 * share:.0f} % of the excess."
    if decision.adequacy and decision.adequacy.told < 1.0:
        text += (
            f" It is judged by the {100 * decision.adequacy.told:.0f} % of the samples that it explains best; what is left is "
            "in the others, as where the law of this device is another one."
        )
    if pairs:
        text += " Not separable with this excitation: " + ", ".join(" / ".join(p) for p in pairs) + "."
    return text + tail


def _times_the_floor(study: Study, beyond: float) -> str:
    """How much is left in a channel, `beyond` what is expected there."""
    return (
        f"{1 + beyond:.3g} times the power of {_floor(study)}"
        if beyond > 0.0
        else f"no more than {_floor(study)}"
    )


def odds_of_rival(
    problem: LinearisedProblem,
    deviation: Floats,
    rival: Floats,
    *,
    dearer: float = 0.0,
    worse: float | None = None,
) -> float:
    """Odds, 0 to 1, of one change of the simulation against another that fits better: their tempered likelihood ratio.

    With n what the better one leaves and d the difference of the two, the logarithm of the likelihood ratio is the sum of
    n d + d^2 / 2: its mean L = sum of d^2 / 2 is certain, what scatters is n d. Where n is noise the variance is 2 L; misfit
    that is correlated over a stretch counts once, however many samples it has: S^2 is the sum over long stretches of
    (sum of n d)^2, at least 2 L. Tempered by S^2 / (2 L), the ratio is exp(-2 L^2 / S^2).

    Parameters
    ----------
    problem : that both were fitted in
    deviation, rival : (N,) whitened
    dearer : what the rival's parameters cost more than the other's, in chi-square, see `explain.cost`
    worse : chi-square that the rival leaves more than the other where each was fitted, if that was elsewhere
    """
    left, others = (
        problem.apply_inverse_covariance(problem.residual - change) for change in (deviation, rival)
    )
    apart = others - left
    chance = left * apart
    ratio = (float(np.sum(chance + 0.5 * apart**2)) if worse is None else 0.5 * worse) + 0.5 * dearer
    scatter = max(float(np.sum(problem.over_stretches(chance) ** 2)), float(apart @ apart), 1e-12)
    return float(np.exp(-2.0 * max(ratio, 0.0) ** 2 / scatter))


def beside_the_first(weights: Floats, odds: Sequence[float]) -> Floats:
    """Return the probabilities (n,) of an answer and its rivals; they sum to one.

    What seems better than the answer was refitted about itself too, and was not: it is as likely at most.

    Parameters
    ----------
    weights : (n,) of the answer and its rivals; the answer's may be zero
    odds : (n - 1,) of each rival against the answer, at least
    """
    against = weights / max(weights[0], np.finfo(np.float64).tiny)
    found = np.maximum(np.minimum(against, 1.0), [1.0, *odds])
    return np.asarray(found / np.sum(found))


def probabilities(costs: Floats, *, temper: float) -> Floats:
    """Return posterior probabilities (n,) of rivals, tempered for what chi-square does not know.

    Parameters
    ----------
    costs : (n,) chi-square of each and what its parameters cost, see `explain.cost`
    temper : divides the log likelihood ratios
    """
    weight = np.exp(-0.5 * (costs - np.min(costs)) / temper)
    return np.asarray(weight / np.sum(weight))
