"""Act 5: close the bag, measure the errors from it, replay it and compare the estimates."""

from __future__ import annotations

import numpy as np
from vo2_identification.bags import read_bag
from vo2_interface.model import operating_point
from vo2_models.recording import TIP_DEFLECTION

from vo2_studies.demo.acts.loops import COMPOSITE, POLYNOMIAL, SIDE_ESTIMATE
from vo2_studies.demo.acts.tracking import SIGNALS
from vo2_studies.demo.errors import (
    estimation_error,
    loop_recordings,
    phase_data,
    recording_part,
    tracking_error,
)
from vo2_studies.demo.stage import Phase, Stage

__all__ = ["run"]

_KEYS = {"steps": "step", "sine": "sine", "multisine": "multisine"}
_REPLAY = "/replayed"


def run(stage: Stage) -> None:
    """End the loops, read the bag, replay it."""
    stage.say("closing the bag and measuring the errors from it")
    stage.graph.check()
    stage.graph.end()
    span = operating_point(stage.preset).deflection_range_m
    found = {phase.name: phase for phase in stage.phases if phase.namespace == COMPOSITE}
    for space in (COMPOSITE, POLYNOMIAL):
        stage.recordings[space] = loop_recordings(stage.bag, space)
    side = read_bag(stage.bag, namespace=SIDE_ESTIMATE.rsplit("/", 1)[0], roles=("estimate",))[0]
    for scheme, space in (("composite", COMPOSITE), ("polynomial", POLYNOMIAL)):
        # the random levels were played to the composite loop, with both schemes listening
        random = {**stage.recordings[COMPOSITE], **(side if space == POLYNOMIAL else {})}
        data = phase_data(random, found["random"])
        stage.data[scheme, "random"] = data
        errors = {"random": estimation_error(data)}
        for phase in stage.phases:
            if phase.namespace == space and phase.name in SIGNALS:
                stage.data[scheme, phase.name] = phase_data(stage.recordings[space], phase)
                errors[_KEYS[phase.name]] = tracking_error(stage.data[scheme, phase.name])
        metrics: dict[str, float] = {}
        for name, error in errors.items():
            metrics[f"{name}_mae_um"] = round(error * 1e6, 4)
            metrics[f"{name}_mae_percent"] = round(100.0 * error / span, 4)
        stage.metrics[scheme] = metrics
    _replay(stage, found["random"], found["steps"])


def _replay(stage: Stage, first: Phase, last: Phase) -> None:
    """Play the recorded measurements to a new estimator; its estimates must be the recorded ones, bit for bit."""
    stage.say("replaying the bag to a new estimator")
    graph, copy = stage.graph, stage.folder / "bag_replayed"
    recordings = stage.recordings[COMPOSITE]
    period = recordings["measurement"].sample_period_s
    graph.start(
        "estimator",
        namespace=_REPLAY,
        parameters={"preset": stage.preset, "kind": "composite"},
        parameter_file=stage.model_file,
    )
    recorder = graph.start(
        "record", name="record_replayed", arguments=["--output", str(copy), "--topics", f"{_REPLAY}/estimate"]
    )
    stage.conductor.wait_for_nodes([f"{_REPLAY}/estimator"])
    stage.conductor.wait_for_recorder(recorder, [f"{_REPLAY}/estimate"])
    # from the first sample after the model was set
    offset = first.start_s - recordings["measurement"].time_s[0] + 0.5 * period
    end_s = last.end_s - 0.5 * period
    with stage.conductor.listen(f"{_REPLAY}/estimate") as newest_s:
        replay = graph.start(
            "replay",
            arguments=[
                str(stage.bag),
                *("--topics", f"{COMPOSITE}/measurement"),
                *("--offset", f"{offset:.6f}", "--duration", f"{last.end_s - first.start_s:.6f}"),
                *("--rate", "1000"),
            ],
            remap={f"{COMPOSITE}/measurement": f"{_REPLAY}/measurement"},
        )
        graph.wait(replay, 60.0)
        # what has been played still waits in the estimator's queue where the processors are slow or busy
        stage.conductor.wait_for("the last replayed estimate", lambda: newest_s() >= end_s, 60.0)
    graph.end(recorder)
    graph.end()
    before = recording_part(recordings["estimate"], first.start_s + 0.5 * period, last.end_s)[TIP_DEFLECTION]
    again = read_bag(copy, namespace=_REPLAY, roles=("estimate",))[0]["estimate"]
    after = recording_part(again, first.start_s + 0.5 * period, last.end_s)[TIP_DEFLECTION]
    same = before.size == after.size and bool(np.array_equal(before, after, equal_nan=True))
    stage.metrics["replay"] = {"samples": int(after.size), "recorded": int(before.size), "equal": same}
    stage.say(
        f"replayed {after.size} samples: the estimates {'equal' if same else 'DIFFER FROM'} the recorded ones"
        + (" bit for bit" if same else "")
    )
