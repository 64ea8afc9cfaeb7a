"""Put a study into words and into the records of the file format."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vo2_models.device.coefficients import HUGE
from vo2_models.diagnosis.check import limits_in_words
from vo2_models.diagnosis.decide import probabilities
from vo2_models.diagnosis.explain import Explanation
from vo2_models.diagnosis.locate import locate
from vo2_models.diagnosis.nominal import JUDGED_UNIT
from vo2_models.diagnosis.result import (
    Candidate,
    ChannelFit,
    Diagnosis,
    Estimate,
    NamedEffect,
)
from vo2_models.effects.record import CHOICE
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

if TYPE_CHECKING:
    from vo2_models.diagnosis.pipeline import Study

__all__ = ["MODEL_DISCREPANCY", "assemble_diagnosis"]

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

TOLD = 2.0
"""Move of a constant, in standard deviations, that is told where constants have changed."""


def assemble_diagnosis(study: Study) -> Diagnosis:
    """Return the diagnosis that a study supports."""
    fit = _fit(study)
    limits = [*limits_in_words(study.findings), *_by_recording(study)]
    if study.constants_chi_square > study.thresholds.constants_reported:
        limits.append(_constant(study))
    if not study.differs:
        return Diagnosis(
            verdict="agrees",
            location=[],
            effects=[],
            candidates=[],
            fit=fit,
            indistinguishable=[],
            next_experiment=None,
            summary=_agrees_summary(study),
            limits=limits,
            excess=_excess(study),
            seconds=study.seconds,
        )
    candidates, probability = _candidates(study)
    effects = _named(study, probability)
    pairs = [list(pair) for pair in study.rival_pairs]
    return Diagnosis(
        verdict="differs",
        location=locate(study.final, study.breakdown),
        effects=effects,
        candidates=candidates,
        fit=fit,
        indistinguishable=pairs,
        next_experiment=study.proposal,
        summary=_summary(study, effects, pairs),
        limits=limits,
        not_excited=list(study.not_excited),
        excess=_excess(study),
        seconds=study.seconds,
    )


def _excess(study: Study) -> dict[str, float]:
    return {**{c: float(v) for c, v in study.excess.items()}, "total": float(study.total_excess)}


def _fit(study: Study) -> dict[str, ChannelFit]:
    if study.judged is None:
        return {}
    span = study.nominal.span
    after = dict(study.judged.after)
    if study.outside is not None and study.chosen is None:
        for row, _, _ in study.problem.iterate():
            noise = study.problem.nominal.noise[row.channel]
            weight = study.problem.weight[row.where]
            use = weight > 0
            left = (
                study.problem.apply_inverse_covariance(study.problem.residual)[row.where]
                - study.outside.prediction[row.where]
            )
            plain = noise.color(left / np.where(use, weight, 1.0))
            after[row.channel] = float(np.sqrt(np.mean(plain[use] ** 2)))
    return {
        c: ChannelFit(study.judged.before[c] / span[c], after[c] / span[c], study.judged.floor[c] / span[c])
        for c in study.judged.before
    }


def _candidates(study: Study) -> tuple[list[Candidate], dict[str, float]]:
    """Candidates with probabilities, and the probability of each key."""
    count = study.problem.count
    everyone = list(study.rivals)
    if study.chosen is not None:
        everyone = [study.chosen, *(r for r in everyone if set(r.keys) != set(study.chosen.keys))]
    if not everyone:
        return [], {}
    # about the best explanation chi-square is lower than about the nominal simulation: compare like with like
    chi = [e.chi_square for e in everyone]
    if study.chosen is not None:
        same = [r for r in study.rivals if set(r.keys) == set(study.chosen.keys)]
        if same:
            chi[0] = min(chi[0], same[0].chi_square) if len(study.chosen.keys) > 1 else same[0].chi_square
    temper = study.thresholds.temper * (1.0 + max(study.remaining_excess, 0.0))
    if study.one_loop and study.chosen is not None:
        temper = max(temper, study.thresholds.temper_on_one_loop * study.chosen.gain)
    weights = probabilities(chi, [len(e.coordinates) for e in everyone], count=count, temper=temper)
    certain = 1.0 if study.outside is None else 0.5 * _best_share(study)
    by_key: dict[str, float] = {}
    best: dict[str, Explanation] = {}
    for weight, explanation in zip(weights, everyone, strict=True):
        for key in explanation.keys:
            by_key[key] = by_key.get(key, 0.0) + float(weight) * certain
            best.setdefault(key, explanation)
    size = {c: study.nominal.span[c] for c in study.excess}
    told = 0.0 if study.chosen is None else _share(study, study.chosen.gain)
    found = []
    for key, probability in sorted(by_key.items(), key=lambda item: -item[1]):
        explanation = best[key]
        name, _, signal = key.partition(":")
        gained = _share(study, explanation.gain)
        own = key in study.chosen.keys if study.chosen else False
        nrmse = {}
        for c in study.excess:
            reached = study.judged.after.get(c, 0.0) if study.judged else 0.0
            if not own:  # from the answer's own error, by how much more of the excess would be left
                left, answer = (max(1.0 + study.excess[c] * (1.0 - g), 1.0) for g in (gained, told))
                reached *= float(np.sqrt(left / answer))
            nrmse[c] = reached / size[c]
        found.append(
            Candidate(
                name,
                min(probability, 1.0),
                nrmse,
                signal or None,
                explained_share=gained,
                why_not="" if own else _why_not(study, explanation),
            )
        )
    return found[:12], by_key


def _constant(study: Study) -> str:
    """What the nuisance model had to change, and which effects would do the same."""
    problem = study.problem
    moved = [
        f"{name} by {shift * spread:+.3g} ({abs(shift):.0f} standard deviations of the calibration)"
        for name, shift, spread in zip(problem.names, study.moved, problem.spreads, strict=True)
        if abs(shift) >= TOLD
    ]
    text = f"this recording asks for another {', '.join(moved)}"
    if not study.differs:
        text += "; too little to tell from an unchanged device whose loops are of another family"
    if study.mimics:
        names = " or ".join(h.record.id for h in study.mimics)
        text += f"; {names} acting all the time would look much the same"
    return text


def _best_share(study: Study) -> float:
    """Return the share of the excess that the best single effect explains, 0 to 1."""
    best = max((e.gain for e in study.singles), default=0.0)
    return float(np.clip(best / max(study.problem.count * study.total_excess, 1e-9), 0.0, 1.0))


def _share(study: Study, gain: float) -> float:
    """Return the share of the excess that a gain is, 0 to 1.

    Where the nuisance model has moved its constants to follow an effect, little or no excess is left to compare with: there the
    share is of the most that any effect explains.
    """
    known = [*study.singles, *study.rivals, *([study.chosen] if study.chosen else [])]
    whole = max([study.problem.count * study.total_excess, *(e.gain for e in known)])
    return float(np.clip(gain / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def _why_not(study: Study, explanation: Explanation) -> str:
    gained = _share(study, explanation.gain)
    if study.chosen is None:
        return f"explains {100 * gained:.0f} % of the excess, which is not enough to name it"
    gap = explanation.chi_square - study.chosen.chi_square
    if explanation.at_bound:
        return f"its fit ends at a physical bound ({', '.join(explanation.at_bound)})"
    worse = np.sqrt(max(gap, 0.0))
    return f"explains {100 * gained:.0f} % of the excess; worse than the answer by {worse:.0f} standard deviations"


def _named(study: Study, probability: dict[str, float]) -> list[NamedEffect]:
    found = []
    if study.chosen is not None:
        for index, hypothesis in enumerate(study.chosen.hypotheses):
            record = hypothesis.record
            parameters = {}
            for name, value in study.chosen.values[index].items():
                if name in hypothesis.switches and abs(value) >= HUGE:
                    continue  # never switched
                unit = hypothesis.parameter(name).unit
                if unit == "channel unit":
                    unit = {"log10 ohm": "ohm"}.get(
                        JUDGED_UNIT[hypothesis.signal], JUDGED_UNIT[hypothesis.signal]
                    )
                form = 0.0 if unit == CHOICE else MODEL_DISCREPANCY[record.stage]
                spread = float(np.hypot(study.chosen.std(index, name), form * value))
                parameters[name] = Estimate(float(value), spread, unit)
            found.append(
                NamedEffect(
                    record.id,
                    float(np.clip(probability.get(hypothesis.key, 1.0), 0.0, 1.0)),
                    record.statement,
                    record.equation,
                    parameters,
                    hypothesis.signal or None,
                )
            )
        # of two that are equally sure, the one first that explains more by itself
        alone = {e.keys[0]: e.gain for e in study.singles}
        keys = {(h.record.id, h.signal or None): h.key for h in study.chosen.hypotheses}
        found.sort(key=lambda e: (-round(e.probability, 2), -alone.get(keys[e.id, e.signal], 0.0)))
    if study.outside is not None or not found:
        found.append(_unknown(study))
    return found


def _unknown(study: Study) -> NamedEffect:
    outside = study.outside
    if study.outside is None and study.moved.size:
        return NamedEffect("unknown", 0.5, f"A constant has changed: {_constant(study)}.", "constant", {})
    shapes = outside.shapes if outside is not None else ()
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
            "The residual exceeds the noise, but neither an effect of the catalogue nor a smooth function of "
            "time, temperature, rate, current or memory describes it on blocks it was not fitted on."
        )
        equation = "none found"
    named = sum(1.0 for _ in (study.chosen.hypotheses if study.chosen else ()))
    probability = 1.0 if not named else 0.5
    if study.chosen is None:
        probability = 1.0 - 0.5 * _best_share(study)
    return NamedEffect("unknown", float(probability), statement, equation, {})


def _by_recording(study: Study) -> list[str]:
    """The excess of each recording where there are several, and whether they contradict each other."""
    problem = study.problem
    if len(problem.parts) < 2:
        return []
    left = problem.apply_inverse_covariance(problem.residual)
    energy, count = np.zeros(len(problem.parts)), np.zeros(len(problem.parts))
    for row in problem.rows:
        energy[row.part] += float(problem.residual[row.where] @ left[row.where])
        count[row.part] += float(np.count_nonzero(problem.weight[row.where]))
    excess = energy / np.maximum(count, 1.0) - 1.0
    told = ", ".join(f"{part.name} {value:.3g}" for part, value in zip(problem.parts, excess, strict=True))
    text = f"excess in noise powers by recording: {told}"
    if excess.max() > 10.0 * max(excess.min(), study.thresholds.excess):
        text += "; they differ unlike each other: diagnose them one by one"
    return [text]


def _of_what(study: Study) -> str:
    """Which channels agree, where one of the two could not be judged."""
    judged = {row.channel for row in study.problem.rows}
    absent = [c for c in (RESISTANCE, TIP_DEFLECTION) if c not in judged]
    if not absent:
        return ""
    return f" in {' and '.join(sorted(judged))} ({' and '.join(absent)} could not be judged)"


def _agrees_summary(study: Study) -> str:
    power = 100 * max(study.total_excess, 0.0)
    return (
        f"Simulation and recording agree{_of_what(study)}: the residual exceeds the noise by {power:.0f} % of its power, "
        "no more than an unchanged device shows."
    )


def _summary(study: Study, effects: list[NamedEffect], pairs: list[list[str]]) -> str:
    where = max(study.excess, key=lambda c: study.excess[c])
    head = f"Simulation and recording differ, most in {where} ({1 + study.excess[where]:.3g} times the noise power)."
    if study.chosen is None and study.moved.size:
        return f"Simulation and recording differ by a constant: {_constant(study)}."
    names = [e.id + (f" on {e.signal}" if e.signal else "") for e in effects if e.id != "unknown"]
    if not names:
        share = study.outside.share if study.outside else 0.0
        return f"{head} Nothing known explains it; a correction without a name removes {100 * share:.0f} % of the excess."
    share = 1.0 - max(study.remaining_excess, 0.0) / max(study.total_excess, 1e-9)
    text = f"{head} Left out: {' and '.join(names)}, which explains {100 * share:.0f} % of the excess."
    if pairs:
        text += " Not separable with this excitation: " + ", ".join(" / ".join(p) for p in pairs) + "."
    return text
