"""Last act: the device gets an effect that nobody tells the diagnosis about; the diagnosis gets the bag."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from vo2_models.device.model import DeviceModel
from vo2_models.recording import COMMANDED_CURRENT

from vo2_identification.bags import read_recording
from vo2_identification.demo.acts.identification import play
from vo2_identification.demo.acts.loops import COMPOSITE
from vo2_identification.demo.concealed import Concealed, conceal, diagnosis_section, failed_section, judge
from vo2_identification.demo.figures import correction_figure
from vo2_identification.demo.graph import GraphError
from vo2_identification.demo.stage import Stage

__all__ = ["run"]

_POLL_S = 0.2
_LIMIT_S = 300.0
"""Time beyond which a diagnosis hangs; it needs some 20 s."""


def run(stage: Stage) -> None:
    """Record the changed device, diagnose, reveal; a failure is told and costs nothing but this section."""
    truth = conceal(stage.effect, stage.preset, stage.seed)
    began = time.monotonic()
    try:
        bag = _record(stage, truth)
        answer = _diagnose(stage, bag)
    except (GraphError, RuntimeError) as error:
        stage.graph.end()
        reason = f"the concealed change was not diagnosed: {error}"
        stage.say(f"FAILED: {reason}")
        stage.failures.append(reason)
        stage.metrics["diagnosis"] = {"failed": str(error), "concealed": truth.plain, "seed": stage.seed}
        stage.sections.append(failed_section(reason, truth, stage.seed))
        return
    outcome = judge(answer, truth)
    stage.metrics["diagnosis"] = {
        "concealed": truth.plain,
        "seed": stage.seed,
        "verdict": answer["verdict"],
        "effects": [each["id"] for each in answer["effects"]],
        "right": outcome.right,
        "limit_stated": outcome.limit_stated,
        "fit": answer["fit"],
        "diagnose_s": round(float(answer.get("seconds", 0.0)), 1),
        "act_s": round(time.monotonic() - began, 1),
    }
    figure = _figure(stage, bag)
    stage.sections.append(diagnosis_section(answer, truth, outcome, stage.seed, figure=figure))
    stage.say(str(answer.get("summary", answer["verdict"])))
    stage.say(f"revealed: {outcome.sentence} (seed {stage.seed})")


def _record(stage: Stage, truth: Concealed) -> Path:
    """Let the graph record the informative excitation on the same device with the effect."""
    if not stage.model_file.exists():
        raise RuntimeError(f"found no {stage.model_file}, need the model of the act identification")
    graph, bag = stage.graph, stage.folder / "bag_concealed"
    graph.end()
    stage.say(
        "giving the device a change that nobody tells the diagnosis about, and recording 10 000 samples"
    )
    # what earlier nodes of the same names said must not count for the new ones
    stage.conductor.statuses.clear()
    topics = [f"{COMPOSITE}/command", f"{COMPOSITE}/measurement"]
    recorder = graph.start(
        "record", name="record_concealed", arguments=["--output", str(bag), "--topics", *topics]
    )
    graph.start(
        "plant",
        parameters={
            "preset": stage.preset,
            "seed": stage.seed,
            "effects": truth.as_parameter,
        },
    )
    graph.start("identifier", parameters={"preset": stage.preset, "fit": False})
    stage.conductor.wait_for_nodes([f"{COMPOSITE}/plant", f"{COMPOSITE}/identifier"])
    stage.conductor.wait_for_listeners(
        {
            (f"{COMPOSITE}/identifier", topics[0]): 2,
            (f"{COMPOSITE}/plant", topics[1]): 2,
        }
    )
    play(
        stage,
        "concealed",
        {
            "excitation.kind": "informative",
            "excitation.seed": stage.seed,
            "excitation.cold_s": 0.0,
            "fit": False,
        },
    )
    stage.conductor.pause(_POLL_S)
    graph.end(recorder)
    graph.end()
    return bag


def _figure(stage: Stage, bag: Path) -> str:
    """Draw what the identified model and the corrected one leave over."""
    stage.show("simulating with the identified and with the corrected model")
    recording, _ = read_recording(bag)
    # the first sample was measured before the first command
    recording = recording.slice(1, len(recording))
    simulated = [
        DeviceModel.load(path).simulate(
            recording[COMMANDED_CURRENT], dt=recording.sample_period_s, noise=False
        )
        for path in (stage.model_file, stage.folder / "diagnosis" / "corrected_model.yaml")
    ]
    return correction_figure(recording, *simulated)


def _diagnose(stage: Stage, bag: Path) -> dict[str, Any]:
    """Run `diagnose` in a process of its own, which gets bag and model and nothing else; return its answer."""
    stage.say("diagnosing the recording")
    output = stage.folder / "diagnosis"
    log = stage.graph.log_folder / "diagnose.log"
    command = [sys.executable, "-m", "vo2_identification.diagnose"]
    command += ["--bag", str(bag), "--model", str(stage.model_file), "--output", str(output)]
    began = time.monotonic()
    with log.open("wb") as stream:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
            env=dict(os.environ),
            start_new_session=True,
        )
    try:
        while process.poll() is None:
            seconds = time.monotonic() - began
            if seconds > _LIMIT_S:
                raise RuntimeError(f"diagnose still runs after {_LIMIT_S:g} s; see {log}")
            stage.show(f"diagnosing for {seconds:.0f} s")
            time.sleep(_POLL_S)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    stage.hush()
    if process.returncode:
        said = " | ".join(log.read_text(errors="replace").strip().splitlines()[-3:]) or "it said nothing"
        raise RuntimeError(f"diagnose ended with status {process.returncode}: {said}")
    try:
        answer: dict[str, Any] = json.loads((output / "diagnosis.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RuntimeError(f"diagnose left no readable diagnosis.json: {error}") from error
    return answer
