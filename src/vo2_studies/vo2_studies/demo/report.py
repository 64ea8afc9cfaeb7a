"""The demo's report: what was done, how large the errors are, with figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vo2_identification.bags.reading import commanded_current
from vo2_interface.model import operating_point
from vo2_models.device.model import DeviceModel
from vo2_models.io import write_whole
from vo2_models.page.page import page, paragraph, section, table
from vo2_models.recording import HEATER_CURRENT, Recording

from vo2_studies.demo.acts.tracking import SIGNALS
from vo2_studies.demo.errors import recording_part
from vo2_studies.demo.figures import identification_figure, random_figure, tracking_figure
from vo2_studies.demo.stage import Stage

__all__ = ["write_report"]

_ROWS = (
    ("random", "self-sensing, 400 random levels", "random"),
    ("steps", "tracking, steps", "step"),
    ("sine", "tracking, 0.1 Hz sinusoid", "sine"),
    ("multisine", "tracking, two frequencies", "multisine"),
)
_SCHEMES = ("composite", "polynomial")
_MEASURED_BEFORE_UM = {"random": 1.10, "step": 1.11, "sine": 0.69, "multisine": 2.43}
"""Dissertation, sections 7.3.2 and 7.4: the composite scheme on the real device [um], of 57.03."""


def write_report(stage: Stage) -> Path:
    """Write `report.html` and return its path."""
    stage.show("drawing the figures")
    parts = []
    if ("composite", "random") in stage.data:
        parts += [_errors(stage), _identification(stage), _random(stage), _tracking(stage), _replay(stage)]
    parts += [*stage.sections, _conditions(stage)]
    title = f"Self-sensing control of a simulated VO2 microactuator ({stage.preset}, seed {stage.seed})"
    lead = (
        "A device under test was identified through a running ROS 2 graph, its deflection estimated from its "
        "resistance, and its position controlled on that estimate. Every number below comes from the recorded bag."
    )
    path = stage.folder / "report.html"
    write_whole(path, page(title, lead, parts))
    return path


def _errors(stage: Stage) -> str:
    rows = []
    for _, label, key in _ROWS:
        cells = [label]
        for scheme in _SCHEMES:
            found = stage.metrics[scheme]
            cells += [f"{found[f'{key}_mae_um']:.3f}", f"{found[f'{key}_mae_percent']:.2f}"]
        before = _MEASURED_BEFORE_UM[key]
        rows.append([*cells, f"{before:.2f}"])
    span = operating_point(stage.preset).deflection_range_m * 1e6
    return section(
        "Errors",
        table(
            f"Mean absolute errors; per cent of the deflection range of {span:.2f} µm",
            [
                "experiment",
                "composite [µm]",
                "composite [%]",
                "polynomial [µm]",
                "polynomial [%]",
                "dissertation [µm]",
            ],
            rows,
        ),
        paragraph(
            "Self-sensing: |estimate − true deflection|. Tracking: |reference − true deflection| after the first 5 % "
            "of the samples, transients included. True is the deflection before the sensor, which only a simulated "
            "device tells. The last column was measured on the real device with the composite scheme; it is a scale, "
            "not a competitor."
        ),
    )


def _identification(stage: Stage) -> str:
    phase = next(each for each in stage.phases if each.name == "identification")
    recording = recording_part(stage.recordings[phase.namespace]["measurement"], phase.start_s, phase.end_s)
    command = stage.recordings[phase.namespace]["command"]
    commanded = commanded_current(command.time_s, command[HEATER_CURRENT], recording.time_s)[1:]
    recording = recording.slice(1, len(recording))
    model = DeviceModel.load(stage.model_file)
    simulated = model.simulate(commanded, dt=recording.sample_period_s, noise=False)
    # what a level settles to: the last sample of each hold
    settled = np.flatnonzero(np.diff(commanded))
    return section(
        "Identification",
        identification_figure(_picked(recording, settled), _picked(simulated, settled)),
        paragraph(
            f"{len(recording)} samples. The resistance law has {model.resistance.memory_size - 1} plays, "
            f"the deflection law {model.deflection.memory_size - 1}; the model file beside this page loads into every node."
        ),
    )


def _picked(recording: Recording, index: NDArray[np.intp]) -> Recording:
    return Recording(
        recording.time_s[index], {name: values[index] for name, values in recording.channels.items()}
    )


def _random(stage: Stage) -> str:
    return section(
        "Self-sensing", random_figure({scheme: stage.data[scheme, "random"] for scheme in _SCHEMES})
    )


def _tracking(stage: Stage) -> str:
    figures = [tracking_figure(s, {scheme: stage.data[scheme, s] for scheme in _SCHEMES}) for s in SIGNALS]
    return section("Tracking with PI control on the estimated deflection", *figures)


def _replay(stage: Stage) -> str:
    found = stage.metrics.get("replay")
    if found is None:
        return ""
    verdict = "equal the recorded ones bit for bit" if found["equal"] else "DIFFER from the recorded ones"
    return section(
        "Replay",
        paragraph(
            f"{found['samples']} recorded measurements were replayed to a new estimator; its estimates {verdict}."
        ),
    )


def _conditions(stage: Stage) -> str:
    rows = [
        ("set-up before the run", f"{stage.metrics['setup_s']:.1f} s"),
        ("run up to this page", f"{stage.metrics['run_s']:.1f} s"),
        ("largest process", f"{stage.metrics['peak_memory_mb']:.0f} MB"),
        ("device seed", str(stage.seed)),
        ("repeat with", f"./vo2 demo --seed {stage.seed} --effect {stage.effect}"),
    ]
    return section("Conditions", table("How this page came about", ["what", "value"], rows))
