"""Write what a diagnosis found: the machine-readable answer, the page for people, the corrected model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from vo2_models.diagnosis.assemble_diagnosis import assemble_diagnosis
from vo2_models.diagnosis.nominal import THERMAL
from vo2_models.diagnosis.pipeline import Study
from vo2_models.diagnosis.report import report_page
from vo2_models.diagnosis.result import Diagnosis, validate
from vo2_models.io import write_whole
from vo2_models.model_file import save_model_parameters
from vo2_models.parameters import Value

__all__ = ["corrected_parameters", "write_results"]


def corrected_parameters(study: Study) -> dict[str, Value]:
    """Return the model's parameters with the named effects added (none, and it is the model itself)."""
    flat = dict(study.nominal.parameters)
    if study.chosen is None:
        return flat
    effects = {**study.nominal.model.effects, **study.chosen.effects}
    model = replace(study.nominal.model, effects=effects)
    flat |= model.to_parameters()
    moved = study.final.moved(study.chosen.shift)
    flat |= {f"model.{name}": float(value) for name, value in moved.items() if name in THERMAL}
    return flat


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
    save_model_parameters(
        folder / "corrected_model.yaml",
        corrected,
        comment=f"Effects added by diagnose: {names}",
    )
    write_whole(folder / "report.html", report)
    diagnosis.save(folder / "diagnosis.json")
    return diagnosis
