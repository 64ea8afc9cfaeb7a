"""Write what a diagnosis found: the machine-readable answer, the page for people, the corrected model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from vo2_models.diagnosis.assemble_diagnosis import assemble_diagnosis
from vo2_models.diagnosis.nominal import THERMAL
from vo2_models.diagnosis.pipeline import Study
from vo2_models.diagnosis.report import report_page
from vo2_models.diagnosis.result import Diagnosis
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
    """Write `diagnosis.json`, `report.html` and `corrected_model.yaml` into `folder`; return the diagnosis."""
    diagnosis = assemble_diagnosis(study)
    diagnosis = replace(
        diagnosis, limits=[*problems, *diagnosis.limits], seconds=seconds or diagnosis.seconds
    )
    folder.mkdir(parents=True, exist_ok=True)
    diagnosis.save(folder / "diagnosis.json")
    names = ", ".join(e.id for e in diagnosis.effects) or "none"
    save_model_parameters(
        folder / "corrected_model.yaml",
        corrected_parameters(study),
        comment=f"Effects added by diagnose: {names}",
    )
    (folder / "report.html").write_text(report_page(study, diagnosis), encoding="utf-8")
    return diagnosis
