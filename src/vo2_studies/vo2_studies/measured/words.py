"""Names, units and sentences that page, table and terminal share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from vo2_models.recording import RESISTANCE

from vo2_studies.measured.preset_diagnosis import PresetDiagnosis
from vo2_studies.measured.study import Judgement, SetStudy

__all__ = [
    "across_sets",
    "diagnosis_sentence",
    "laws_won",
    "parameters_text",
    "scale_of",
    "unit_of",
    "verdict",
]


NOTHING = 0.25
"""Share of the excess below which an explanation explains nothing."""


def unit_of(study: SetStudy) -> str:
    """Unit in which errors are told."""
    return "log10 Ω" if study.cases[0].channel == RESISTANCE else "µm"


def scale_of(study: SetStudy) -> float:
    """Factor from the judged unit to the one errors are told in."""
    return 1.0 if study.cases[0].channel == RESISTANCE else 1e6


def verdict(study: SetStudy) -> str:
    """What was found in a set, in a few sentences."""
    simple, chosen, best = study.of(study.reference), study.chosen, study.best
    scale, unit = scale_of(study), unit_of(study)

    def errors(judged: Judgement) -> str:
        return f"{scale * simple.held:.3g} ({simple.candidate.id}) to {scale * judged.held:.3g} {unit} r.m.s."

    name = chosen.candidate.id
    if study.named:
        text = [f"Named: {name}. It lowers the held-out error from {errors(chosen)}"]
    elif chosen.gain < NOTHING:
        text = [f"Nothing of the catalogue can be named: {'; '.join(study.reasons)}"]
    else:
        text = [
            f"Not named, but not nothing: of the catalogue {name} fits best and lowers the held-out error from "
            f"{errors(chosen)}, {100 * chosen.gain:.0f} % of the excess; however, {'; '.join(study.reasons)}"
        ]
    if best is not chosen and best.candidate.id not in ("one_lag", "rate_independent"):
        kind = (
            "effect of the catalogue"
            if best.candidate.in_catalogue
            else "law that the catalogue does not have"
        )
        if best.gain >= max(NOTHING, chosen.gain):
            text.append(
                f"What was held out is predicted best by a {kind}, {best.candidate.id}: {scale * best.held:.3g} {unit}, "
                f"{100 * best.gain:.0f} % of the excess"
            )
    elif best is not chosen:
        text.append("No candidate predicts what was held out better than the simple models")
    return " ".join(part if part.endswith(".") else f"{part}." for part in text)


def across_sets(studies: Sequence[SetStudy]) -> list[str]:
    """What only several sets together show."""
    found = []
    slower = {
        study.key: max(
            float(np.median([fit.values[name] for fit in study.of("second_thermal_mode").fits]))
            for name in ("second_thermal_mode.time_constant", "thermal.time_constant")
        )
        for study in studies
        if study.laws
    }
    if len(slower) > 1:
        told = ", ".join(f"{key} {value:.2g} s" for key, value in slower.items())
        text = f"The slower constant of second_thermal_mode, median over the splits: {told}."
        if max(slower.values()) > 5.0 * min(slower.values()):
            text += (
                " Two bodies would have the same two constants whatever the pulse. One that changes with the length of "
                "what is looked at is a point of a spread of heat paths, as of heat that spreads into a substrate."
            )
        found.append(text)
    laws: dict[str, list[int]] = {}
    for study in studies:
        for law, counts in laws_won(study).items():
            own = laws.setdefault(law, [0, 0])
            own[0], own[1] = own[0] + counts[0], own[1] + counts[1]
    if laws:
        count = sum(own[1] for own in laws.values())
        told = ", ".join(f"{law} {own[0]} and {own[1]}" for law, own in laws.items())
        found.append(
            f"Which law predicts each of the {count} relaxations best, between and later than what was fitted: {told}."
        )
    return found


def diagnosis_sentence(found: PresetDiagnosis) -> str:
    """Answer of the diagnosis itself."""
    if found.diagnosis is None:
        return f"The diagnosis refuses: {found.refusal}"
    if not found.diagnosis.effects:
        return f"The diagnosis: {found.diagnosis.summary}"
    effects = ", ".join(effect.id for effect in found.diagnosis.effects)
    fits = "; ".join(
        f"{channel} held out {100 * fit.nrmse_before:.3g} to {100 * fit.nrmse_after:.3g} % of range"
        for channel, fit in found.diagnosis.fit.items()
    )
    return f"The diagnosis ({effects}; {fits}): {found.diagnosis.summary}"


def laws_won(study: SetStudy) -> dict[str, tuple[int, int]]:
    """Law -> number of recordings on which its error is least, between and later."""
    won: dict[str, list[int]] = {}
    for result in study.laws:
        for place, errors in enumerate((result.between, result.later)):
            for law in errors:
                won.setdefault(law, [0, 0])
            won[min(errors, key=lambda law: errors[law])][place] += 1
    return {law: (counts[0], counts[1]) for law, counts in won.items()}


def parameters_text(judged: Judgement) -> str:
    """Parameters of each fold, with standard deviations."""
    parts = []
    for name in judged.fits[0].values:
        values = " | ".join(f"{fit.values[name]:.3g} ± {fit.std[name]:.1g}" for fit in judged.fits)
        parts.append(f"{name.replace('thermal.time_constant', 'lag')} {values}")
    return "; ".join(parts)
