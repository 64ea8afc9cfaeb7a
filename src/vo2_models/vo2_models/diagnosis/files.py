"""Write what a diagnosis found: the machine-readable answer, the page for people, the corrected model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo2_models.diagnosis.nominal import THERMAL
from vo2_models.diagnosis.page import report_page
from vo2_models.diagnosis.report import assemble_diagnosis
from vo2_models.diagnosis.result import Diagnosis, validate
from vo2_models.diagnosis.stages import Study
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.io import write_whole
from vo2_models.model_file import save_model_parameters
from vo2_models.parameters import Value

__all__ = ["corrected_parameters", "write_results"]


def corrected_parameters(study: Study) -> dict[str, Value]:
    """Return the model's parameters with named effects and moved constants (none of them, and it is the model itself)."""
    flat, decision = dict(study.located.nominal.parameters), study.decision
    if decision.verdict == "agrees":
        return flat
    model = study.located.nominal.model
    chosen = decision.chosen.effects if decision.chosen else {}
    values = decision.final.moved(decision.drift.weights)
    zero, gain = values.get("deflection.zero", 0.0), values.get("deflection.gain", 1.0)
    model = replace(
        model,
        effects={**model.effects, **chosen},
        scalars={**model.scalars, **{name: values[name] for name in THERMAL if name in values}},
        deflection=_scaled(model.deflection, gain, zero),
        # the law is that of -log10 R
        resistance=_scaled(model.resistance, 1.0, -float(np.log10(values.get("resistance.gain", 1.0)))),
    )
    return flat | model.to_parameters()


def _scaled(bank: PlayBank, gain: float, zero: float) -> PlayBank:
    """The law gain y + zero, zero in the output's unit."""
    if not bank.present:
        return bank
    polynomial = gain * np.asarray(bank.polynomial)
    polynomial[0] += zero
    return replace(bank, weights=gain * np.asarray(bank.weights), polynomial=polynomial)


def write_results(
    study: Study, folder: Path, *, problems: Sequence[str] = (), seconds: float = 0.0
) -> Diagnosis:
    """Write `RESULTS` into `folder`, each whole or not at all; return the diagnosis.

    Raises
    ------
    ValueError : a result that cannot be written down; nothing is written.
    OSError : the disk is full or the folder cannot be written; names the file.
    """
    diagnosis = assemble_diagnosis(study)
    diagnosis = replace(
        diagnosis, limits=[*problems, *diagnosis.limits], seconds=seconds or diagnosis.seconds
    )
    report = report_page(study, diagnosis)
    corrected = corrected_parameters(study)
    # nothing is written before everything is known to be sound
    validate(diagnosis.to_dict())
    names = ", ".join(e.id for e in diagnosis.effects) or "none"
    moved = ", ".join(m.constant for m in diagnosis.moved) or "none"
    save_model_parameters(
        folder / "corrected_model.yaml",
        corrected,
        comment=f"Effects added by diagnose: {names}; constants moved: {moved}",
    )
    write_whole(folder / "report.html", report)
    diagnosis.save(folder / "diagnosis.json")
    return diagnosis
