"""Act 6: the device gets an effect that nobody tells the diagnosis about; the diagnosis starts on the new bag.

It runs in a process of its own beside the next act, and keeps one processor busy.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from vo2_studies.demo.acts.identification import play
from vo2_studies.demo.acts.loops import COMPOSITE
from vo2_studies.demo.concealed import Concealed, conceal, failed_section
from vo2_studies.demo.graph import GraphError
from vo2_studies.demo.stage import Diagnosing, Stage

__all__ = ["failed", "run", "start_diagnosis"]

_SETTLE_S = 0.2


def run(stage: Stage) -> None:
    """Record the changed device, start the diagnosis; a failure is told and costs nothing but its section."""
    truth = conceal(stage.effect, stage.preset, stage.seed)
    try:
        stage.diagnosing = start_diagnosis(stage, _record(stage, truth), truth)
    except (GraphError, RuntimeError) as error:
        stage.graph.end()
        failed(stage, truth, error)


def failed(stage: Stage, truth: Concealed, error: Exception) -> None:
    """Tell that there is no diagnosis, and why."""
    reason = f"the concealed change was not diagnosed: {error}"
    stage.say(f"FAILED: {reason}")
    stage.failures.append(reason)
    stage.metrics["diagnosis"] = {"failed": str(error), "concealed": truth.plain, "seed": stage.seed}
    stage.sections.append(failed_section(reason, truth, stage.seed))


def _record(stage: Stage, truth: Concealed) -> Path:
    """Let the graph record the informative excitation on the same device with the effect."""
    if not stage.model_file.exists():
        raise RuntimeError(f"found no {stage.model_file}, need the model of the act identification")
    graph, bag = stage.graph, stage.folder / "bag_concealed"
    graph.end()
    stage.say(
        "giving the device a change that nobody tells the diagnosis about, and recording 10 000 samples"
    )
    stage.conductor.forget()
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
    stage.conductor.wait_for_recorder(recorder, topics)
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
    stage.conductor.pause(_SETTLE_S)
    graph.end(recorder)
    graph.end()
    return bag


def start_diagnosis(stage: Stage, bag: Path, truth: Concealed) -> Diagnosing:
    """Start `diagnose`, which gets bag and model and nothing else."""
    stage.say("diagnosing the recording, in a process of its own")
    output, log = stage.folder / "diagnosis", stage.graph.log_folder / "diagnose.log"
    command = [sys.executable, "-m", "vo2_identification.diagnose"]
    command += ["--bag", str(bag), "--model", str(stage.model_file), "--output", str(output)]
    with log.open("wb") as stream:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
            env=dict(os.environ),
            start_new_session=True,
        )
    return Diagnosing(process, time.monotonic(), log, bag, output, truth)
