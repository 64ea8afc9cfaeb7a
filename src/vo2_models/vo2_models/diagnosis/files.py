"""Write what a diagnosis found: the machine-readable answer, the page for people, the corrected model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vo2_models.diagnosis.corrected_model import CorrectedModel, StandIn, corrected_model
from vo2_models.diagnosis.nominal import THERMAL
from vo2_models.diagnosis.page import report_page
from vo2_models.diagnosis.report import assemble_diagnosis, in_own_names
from vo2_models.diagnosis.result import Diagnosis, validate
from vo2_models.diagnosis.stages import Study
from vo2_models.io import write_whole
from vo2_models.model_file import save_model_parameters

__all__ = ["write_results"]


def write_results(
    study: Study, folder: Path, *, problems: Sequence[str] = (), seconds: float = 0.0
) -> Diagnosis:
    """Write `RESULTS` into `folder`, each whole or not at all; return the diagnosis.

    Parameters
    ----------
    study : of the recordings
    folder : is made where it does not exist
    problems : what reading the bags had to say, for the limits
    seconds : that it all took, for the page; those of the study by default

    Raises
    ------
    ValueError : a result that cannot be written down; nothing is written.
    OSError : the disk is full or the folder cannot be written; names the file.
    """
    diagnosis = assemble_diagnosis(study)
    corrected = corrected_model(study)
    unnamed = corrected.unnamed
    said = [in_own_names(unnamed.in_words(), study)] if unnamed else []
    if study.decision.verdict == "differs" and study.decision.chosen is None and not unnamed:
        said = [
            "corrected_model.yaml has no correction of what has no name: no term of the catalogue comes near it"
        ]
    fitted = _fitted_beside(corrected, diagnosis, study)
    if fitted:
        said.append(
            f"corrected_model.yaml holds constants that were fitted beside the answer and are not told to have moved: {fitted}"
        )
    if corrected.impossible:
        said.append(
            "corrected_model.yaml keeps the constants of the calibration, as those that were found are of no possible device "
            f"({corrected.impossible.partition(':')[0]} is out of its bounds): check that command and measurement are of one run"
        )
    elif means := sorted({m.constant for m in diagnosis.moved if m.recording}):
        said.append(f"corrected_model.yaml holds the mean over the recordings of {', '.join(means)}")
    if study.verdict != "agrees" and not corrected.impossible:
        said += _farther_off(corrected, diagnosis, study)
    diagnosis = replace(
        diagnosis, limits=[*problems, *diagnosis.limits, *said], seconds=seconds or diagnosis.seconds
    )
    report = report_page(study, diagnosis)
    # nothing is written before everything is known to be sound
    validate(diagnosis.to_dict())
    names = ", ".join(e.id for e in diagnosis.effects) or "none"
    moved = ("" if corrected.impossible else ", ".join(map(str, diagnosis.moved))) or "none"
    save_model_parameters(
        folder / "corrected_model.yaml",
        corrected.parameters,
        comment=f"Effects added by diagnose: {names}{_standing(unnamed)}; constants moved: {moved}"
        + (f"; fitted besides: {fitted}" if fitted else ""),
    )
    write_whole(folder / "report.html", report)
    diagnosis.save(folder / "diagnosis.json")
    return diagnosis


def _fitted_beside(corrected: CorrectedModel, diagnosis: Diagnosis, study: Study) -> str:
    """The constants that differ in the file from those of the model, but for those that are told."""
    told, before = {m.constant for m in diagnosis.moved}, study.located.nominal.parameters
    return ", ".join(
        f"{name} {float(corrected.parameters[key]):.5g}"  # type: ignore[arg-type]
        for name in THERMAL
        if name not in told
        and (key := f"model.{name}") in corrected.parameters
        and not np.isclose(corrected.parameters[key], before.get(key, np.nan), rtol=1e-4)
    )


def _standing(unnamed: StandIn | None) -> str:
    """What stands for the unknown in the file."""
    return f" (described by {', '.join(unnamed.option.chosen.keys)})" if unnamed else ""


def _farther_off(corrected: CorrectedModel, diagnosis: Diagnosis, study: Study) -> list[str]:
    """A sentence for what the file leaves where that is more than the diagnosis leaves, and what the file does not hold."""
    told, chosen = [], study.decision.chosen
    beside = "beside corrections of the loops that no law holds"
    if chosen is not None and chosen.courses:
        names = " and ".join(key.partition(":")[0] for key in chosen.courses)
        beside = f"with the course of {names}, which is these recordings' own: the file has no more than its straight part"
    for channel, nrmse in corrected.nrmse.items():
        name = in_own_names(channel, study)
        fit = diagnosis.fit.get(name)
        if fit and nrmse > study.limits.by_itself * max(fit.nrmse_after, fit.noise_floor):
            told.append(
                f"corrected_model.yaml by itself leaves {100 * nrmse:.2g} % of the range in {name}; the "
                f"{100 * fit.nrmse_after:.2g} % of the answer are left {beside}"
            )
    return told
