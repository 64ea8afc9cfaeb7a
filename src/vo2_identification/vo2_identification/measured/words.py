"""Names, units and sentences that page, table and terminal share."""

from __future__ import annotations

from vo2_models.recording import RESISTANCE

from vo2_identification.measured.preset_diagnosis import PresetDiagnosis
from vo2_identification.measured.study import Judgement, SetStudy

__all__ = ["diagnosis_sentence", "laws_won", "parameters_text", "scale_of", "unit_of", "verdict"]


def unit_of(study: SetStudy) -> str:
    """Unit in which errors are told."""
    return "log10 Ω" if study.cases[0].channel == RESISTANCE else "µm"


def scale_of(study: SetStudy) -> float:
    """Factor from the judged unit to the one errors are told in."""
    return 1.0 if study.cases[0].channel == RESISTANCE else 1e6


def verdict(study: SetStudy) -> str:
    """What was found in a set, in two sentences."""
    simple, chosen, best = study.of(study.reference), study.chosen, study.best
    scale, unit = scale_of(study), unit_of(study)

    def errors(judged: Judgement) -> str:
        return f"{scale * simple.held:.3g} ({simple.candidate.id}) to {scale * judged.held:.3g} {unit} r.m.s."

    name = chosen.candidate.id
    if study.named:
        first = f"Named: {name}. It lowers the held-out error from {errors(chosen)}"
        if study.rivals:
            first += f"; {', '.join(study.rivals)} predicts as well and is not told apart by this recording"
        return first + "."
    first = f"Nothing is named: {'; '.join(study.reasons)}."
    if best.candidate.id in ("one_lag", "rate_independent") or best.gain < 0.25:
        return (
            first + " No other candidate predicts what was held out better by a quarter of the excess either."
        )
    kind = "effect of the catalogue" if best.candidate.in_catalogue else "law from outside the catalogue"
    return (
        f"{first} Best on held-out data is the {kind} {best.candidate.id}: from {errors(best)}, "
        f"{100 * best.gain:.0f} % of the excess."
    )


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
