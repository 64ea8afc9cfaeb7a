"""Act 7: other people's measurements: converted, replayed, identified from the replay, predicted where unseen."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from vo2_identification.bags import read_bag
from vo2_models.identification.drive_fit import HoldOut, held_out
from vo2_models.page.page import paragraph, section, table
from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording

from vo2_studies.demo.figures import measured_figure
from vo2_studies.demo.graph import GraphError
from vo2_studies.demo.stage import Stage

__all__ = ["run"]

_SECOND_PASS = "second_pass"
_DATA = Path("..") / "shared" / "data"


@dataclass(frozen=True)
class _Rig:
    """One measured recording: which file, which map, which channel is predicted, what the fit does not see."""

    name: str
    title: str
    file: str
    map: str
    output: str
    rate: float
    hold_out: HoldOut
    fit: dict[str, Value]
    remark: str

    @property
    def space(self) -> str:
        """Namespace of its nodes."""
        return f"/measured_{self.name}"


_RIGS = (
    _Rig(
        "film",
        "VO2 film on a source-meter (Galloni et al. 2024)",
        "vo2_device/VO2_data_RvsV_transition.csv",
        "vo2_device_sweep",
        RESISTANCE,
        300.0,
        "blocks",
        {"drive_plays": 6, "drive_per_play": True},
        "A single loop of voltage and resistance, without deflection: the resistance is predicted from the voltage. Every "
        "third block of ten samples was kept from the fit.",
    ),
    _Rig(
        "piezo",
        "Piezo actuator (Yan Naing Aye 2019)",
        "piezo/Model_Vi_Do.dat",
        "piezo",
        TIP_DEFLECTION,
        20.0,
        "end",
        {"drive_plays": 8},
        "Voltage and displacement with many minor loops, without resistance: the displacement is predicted from the voltage. "
        "The second half of the recording was kept from the fit.",
    ),
)


def run(stage: Stage) -> None:
    """Do it for the recordings that are there, side by side; say which are not."""
    parts = []
    found = []
    for rig in _RIGS:
        source = _find(rig.file)
        if source is None:
            text = f"{rig.title}: skipped, {_DATA / rig.file} is not there (the data folder lies beside the checkout)."
            stage.say(text)
            parts.append(paragraph(text))
        else:
            found.append((rig, source))
    if found:
        stage.say(f"measured input, converted and replayed: {'; '.join(rig.title for rig, _ in found)}")
        parts += _side_by_side(stage, found)
    stage.sections.append(section("Measured input", *parts))


def _find(file: str) -> Path | None:
    """Look beside the folder that the demo runs in, and beside the checkout that holds this file."""
    for base in (Path.cwd(), *Path(__file__).resolve().parents):
        if (base / _DATA / file).exists():
            return base / _DATA / file
    return None


def _side_by_side(stage: Stage, found: list[tuple[_Rig, Path]]) -> list[str]:
    graph, conductor = stage.graph, stage.conductor
    rigs = [rig for rig, _ in found]
    folder = stage.folder / "measured"
    for rig, source in found:
        arguments = ["--map", rig.map, "--input", str(source), "--output", str(folder / rig.name)]
        graph.start("convert", name=f"convert_{rig.name}", arguments=arguments)
        _start_nodes(stage, rig)
    conductor.wait_for_nodes([f"{rig.space}/{node}" for rig in rigs for node in ("estimator", "identifier")])
    for process in [each for each in graph.processes if "_record_" in each.name]:
        rig = next(rig for rig in rigs if process.name.endswith(rig.name))
        conductor.wait_for_recorder(process, [f"{rig.space}/estimate"])
    for process in [each for each in graph.processes if "convert" in each.name]:
        graph.wait(process, 60.0)
    for rig in rigs:
        conductor.trigger(f"{rig.space}/identifier/start")
    _replay(stage, rigs, "measurement")
    for rig in rigs:
        status = f"{rig.space.strip('/')}/identifier: progress"

        def ended(status: str = status) -> bool:
            return conductor.value(status, "state") in ("done", "failed")

        conductor.wait_for(f"the model of {rig.name}", ended, 90.0)
        if conductor.value(status, "state") != "done":
            raise GraphError(f"{rig.name}: {conductor.statuses[status][1]}")
    with ExitStack() as stack:
        newest_s = [stack.enter_context(conductor.listen(f"{rig.space}/estimate")) for rig in rigs]
        _replay(stage, rigs, _SECOND_PASS)
        # what has been played still waits in an estimator's queue where the processors are slow or busy
        for rig, newest in zip(rigs, newest_s, strict=True):
            end_s = _measured(stage, rig).time_s[-1]
            conductor.wait_for(
                f"the last prediction of {rig.name}", partial(_reached, newest, end_s - 1e-6), 60.0
            )
    graph.end()
    return [_evaluate(stage, rig) for rig in rigs]


def _reached(newest_s: Callable[[], float], end_s: float) -> bool:
    return newest_s() >= end_s


def _measured(stage: Stage, rig: _Rig) -> Recording:
    return read_bag(stage.folder / "measured" / rig.name, roles=("measurement",))[0]["measurement"]


def _start_nodes(stage: Stage, rig: _Rig) -> None:
    drive = {"drive_channel": "heater_voltage"}
    # the estimator hears the second pass only: each pass then has one listener, which replay waits for
    stage.graph.start(
        "estimator",
        namespace=rig.space,
        parameters={"kind": "drive", **drive},
        remap={"measurement": _SECOND_PASS},
    )
    stage.graph.start(
        "identifier",
        namespace=rig.space,
        parameters={
            "excitation.kind": "listen",
            "quiet_s": 0.5,
            "drive_hold_out": rig.hold_out,
            **drive,
            **rig.fit,
        },
    )
    predicted = stage.folder / "measured" / f"{rig.name}_predicted"
    stage.graph.start(
        "record",
        name=f"record_{rig.name}",
        arguments=["--output", str(predicted), "--topics", f"{rig.space}/estimate"],
    )


def _replay(stage: Stage, rigs: list[_Rig], topic: str) -> None:
    """Play the converted bags on a topic of their rigs."""
    playing = [
        stage.graph.start(
            "replay",
            name=f"replay_{rig.name}",
            arguments=[str(stage.folder / "measured" / rig.name), "--rate", f"{rig.rate:g}"],
            remap={"/vo2/measurement": f"{rig.space}/{topic}"},
        )
        for rig in rigs
    ]
    for process in playing:
        stage.graph.wait(process, 90.0)


def _evaluate(stage: Stage, rig: _Rig) -> str:
    recording = _measured(stage, rig)
    copy = stage.folder / "measured" / f"{rig.name}_predicted"
    estimate = read_bag(copy, namespace=rig.space, roles=("estimate",))[0]["estimate"]
    drive, measured = recording["heater_voltage"], recording[rig.output]
    unseen = held_out(drive, rig.hold_out)
    predicted = estimate[rig.output]
    if predicted.size != measured.size or not np.all(np.isfinite(predicted)):
        raise GraphError(
            f"{rig.name}: {np.sum(np.isfinite(predicted))} predictions for {measured.size} samples"
        )
    # resistance is judged in decades, deflection in micrometres
    if rig.output == RESISTANCE:
        error, span, unit = np.log10(predicted / measured), float(np.ptp(np.log10(measured))), "log10 Ω"
    else:
        error, span, unit = (predicted - measured) * 1e6, float(np.ptp(measured)) * 1e6, "µm"
    rows, metrics = [], {}
    for label, key, part in (("seen by the fit", "fit", ~unseen), ("held out", "held_out", unseen)):
        mean, largest = float(np.mean(np.abs(error[part]))), float(np.max(np.abs(error[part])))
        rows.append(
            [
                label,
                str(np.sum(part)),
                f"{mean:.4f}",
                f"{100 * mean / span:.2f}",
                f"{100 * largest / span:.2f}",
            ]
        )
        metrics[f"{key}_mae"] = round(mean, 6)
        metrics[f"{key}_mae_percent"] = round(100 * mean / span, 4)
    stage.metrics.setdefault("measured", {})[rig.name] = {"unit": unit, **metrics}
    header = ["part", "samples", f"mean |error| [{unit}]", "[% of range]", "largest [% of range]"]
    return (
        table(f"{rig.title}: prediction of {rig.output}", header, rows)
        + measured_figure(rig.title, rig.output, drive, measured, predicted, unseen)
        + paragraph(rig.remark)
    )
