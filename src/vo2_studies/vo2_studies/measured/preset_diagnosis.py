"""The diagnosis itself on a measured set: its preset's assumptions, the fit made here as its simulation.

The simulation given to it has one lag and no effect, fitted to the training recordings; it sees the held-out ones, all
samples. Where its checks refuse a set, the reason is the answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from vo2_models.device.model import SensorModel
from vo2_models.diagnosis.pipeline import study as diagnose_study
from vo2_models.diagnosis.report import assemble_diagnosis
from vo2_models.diagnosis.result import Diagnosis
from vo2_models.recording import RESISTANCE

from vo2_studies.measured.cases import Case
from vo2_studies.measured.study import SetStudy

__all__ = ["PresetDiagnosis", "diagnose_set"]

LEAST_JUDGED = 0.6
"""Share of a recording's samples that is judged at least; the diagnosis refuses below a half."""


@dataclass(frozen=True)
class PresetDiagnosis:
    """What the diagnosis answers.

    Attributes
    ----------
    diagnosis : its answer, None where it refuses
    refusal : why it refuses, empty where it does not
    recordings : labels of the recordings it saw
    """

    diagnosis: Diagnosis | None
    refusal: str
    recordings: tuple[str, ...]


def diagnose_set(
    found: SetStudy, *, progress: Callable[[float, str], None] = lambda share, text: None
) -> PresetDiagnosis:
    """Give the held-out recordings of a set's first fold, and the lag's fit, to the diagnosis."""
    fit = found.of("one_lag").fits[0]
    channel = found.cases[0].channel
    factor = np.log(10.0) if channel == RESISTANCE else 1.0
    sensor = SensorModel(noise=factor * found.noise, residual=fit.rms)
    model = replace(fit.model, sensors={channel: sensor})
    labels = tuple(case.label for case in found.folds[0].held)
    cases = [case for case in found.cases if case.label in labels]
    try:
        answer = diagnose_study(
            [_shortened(case).recording for case in cases], model.to_parameters(), progress=progress
        )
    except ValueError as error:
        return PresetDiagnosis(None, " ".join(str(error).split()), labels)
    return PresetDiagnosis(assemble_diagnosis(answer), "", labels)


def _shortened(case: Case) -> Case:
    """The recording without so much of its pulse that most of its samples are judged."""
    judged = np.flatnonzero(np.isfinite(case.recording[case.channel]))
    size = len(case.recording)
    if judged.size >= LEAST_JUDGED * size:
        return case
    start = max(size - int(judged.size / LEAST_JUDGED), 0)
    return replace(
        case,
        recording=case.recording.slice(start, size),
        since_s=case.since_s[start:],
        drive=case.drive[start:],
    )
