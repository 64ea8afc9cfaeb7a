"""Last act: the answer of the diagnosis, and only then what was concealed."""

from __future__ import annotations

import json
import time
from typing import Any

from vo2_identification.bags import read_recording
from vo2_models.device.model import DeviceModel
from vo2_models.recording import COMMANDED_CURRENT

from vo2_studies.demo.acts.change import failed
from vo2_studies.demo.concealed import diagnosis_section, judge
from vo2_studies.demo.figures import correction_figure
from vo2_studies.demo.stage import Diagnosing, Stage

__all__ = ["run"]

_POLL_S = 0.1
_LIMIT_S = 300.0
"""Time beyond which a diagnosis hangs; it needs some 20 s."""


def run(stage: Stage) -> None:
    """Wait for the diagnosis, reveal; a failure is told and costs nothing but this section."""
    job = stage.diagnosing
    if job is None:  # it could not start, and the act before has said why
        return
    try:
        answer = _answer(stage, job)
    except RuntimeError as error:
        failed(stage, job.truth, error)
        return
    outcome = judge(answer, job.truth)
    stage.metrics["diagnosis"] = {
        "concealed": job.truth.plain,
        "seed": stage.seed,
        "verdict": answer["verdict"],
        "effects": [each["id"] for each in answer["effects"]],
        "right": outcome.right,
        "limit_stated": outcome.limit_stated,
        "fit": answer["fit"],
        "diagnose_s": round(float(answer.get("seconds", 0.0)), 1),
    }
    figure = _figure(stage, job)
    stage.sections.append(diagnosis_section(answer, job.truth, outcome, stage.seed, figure=figure))
    stage.say(str(answer.get("summary", answer["verdict"])))
    stage.say(f"revealed: {outcome.sentence} (seed {stage.seed})")


def _answer(stage: Stage, job: Diagnosing) -> dict[str, Any]:
    """Wait until `diagnose` ends; return its diagnosis.json."""
    if job.process.poll() is None:
        stage.say("waiting for the diagnosis")
    while job.process.poll() is None:
        seconds = time.monotonic() - job.began
        if seconds > _LIMIT_S:
            job.end()
            raise RuntimeError(f"diagnose still runs after {_LIMIT_S:g} s; see {job.log}")
        stage.show(f"diagnosing for {seconds:.0f} s")
        time.sleep(_POLL_S)
    stage.hush()
    if job.process.returncode:
        said = " | ".join(job.log.read_text(errors="replace").strip().splitlines()[-3:]) or "it said nothing"
        raise RuntimeError(f"diagnose ended with status {job.process.returncode}: {said}")
    try:
        answer: dict[str, Any] = json.loads((job.output / "diagnosis.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RuntimeError(f"diagnose left no readable diagnosis.json: {error}") from error
    return answer


def _figure(stage: Stage, job: Diagnosing) -> str:
    """Draw what the identified model and the corrected one leave over."""
    stage.show("simulating with the identified and with the corrected model")
    recording, _ = read_recording(job.bag)
    # the first sample was measured before the first command
    recording = recording.slice(1, len(recording))
    simulated = [
        DeviceModel.load(path).simulate(
            recording[COMMANDED_CURRENT], dt=recording.sample_period_s, noise=False
        )
        for path in (stage.model_file, job.output / "corrected_model.yaml")
    ]
    return correction_figure(recording, *simulated)
