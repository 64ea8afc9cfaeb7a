"""What is done with one bag, in whatever process; it returns what is to be written and writes nothing itself."""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from vo2_models.io import one_line
from vo2_models.parameters import Value

from vo2_identification.batch.folder import bag_note

if TYPE_CHECKING:
    from vo2_models.device.model import DeviceModel
    from vo2_models.hysteresis.play_bank import PlayBank

__all__ = ["Outcome", "Task", "work"]

Row = dict[str, Any]
"""Column -> number, text or None; a row of the table."""


@dataclass(frozen=True)
class Task:
    """One bag and what to do with it.

    Attributes
    ----------
    name : of the bag below its folder
    bag : where it is, as every worker sees it
    command : fit or diagnose
    device : as `preset` takes it, the whole description where it is no shipped one
    parameters : of the model, for diagnose
    calibration : bags that the model was fitted to, for diagnose
    options : of the command
    effects : folders of effect files
    cores : how many threads one bag may take
    """

    name: str
    bag: str
    command: str
    device: str = ""
    parameters: Mapping[str, Value] = field(default_factory=dict)
    calibration: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    effects: str = ""
    cores: int = 1


@dataclass(frozen=True)
class Outcome:
    """What came of one bag.

    Attributes
    ----------
    row : for the table
    files : name -> content of what belongs into the bag's folder
    reason : why the bag was refused; empty where it was not
    seconds : wall time that it took
    """

    row: Row
    files: dict[str, bytes] = field(default_factory=dict)
    reason: str = ""
    seconds: float = 0.0


def work(task: Task) -> Outcome:
    """Return the outcome of the fit or diagnosis of one bag; what cannot be used is an outcome too.

    Parameters
    ----------
    task : what to do with which bag
    """
    began = time.perf_counter()
    if task.effects:
        from vo2_models.effects.catalogue import VARIABLE

        os.environ[VARIABLE] = task.effects
    from vo2_models.numerics.parallel import use_cores

    use_cores(task.cores)
    note, told = bag_note(Path(task.bag))
    row: Row = {
        "bag": task.name,
        "device_id": note.device_id,
        "position_x_m": None if np.isnan(note.position_x_m) else note.position_x_m,
        "position_y_m": None if np.isnan(note.position_y_m) else note.position_y_m,
    }
    try:
        with warnings.catch_warnings(), TemporaryDirectory(prefix="vo2_batch_") as place:
            # many alike in one batch: what matters stands in the row
            warnings.simplefilter("ignore", UserWarning)
            found = (_fit if task.command == "fit" else _diagnose)(task, Path(place))
            files = {each.name: each.read_bytes() for each in sorted(Path(place).iterdir())}
    except ValueError as error:
        reason = one_line(error)
        return Outcome(row | {"status": "refused", "reason": reason}, {}, reason, time.perf_counter() - began)
    problems = [*told, *found.pop("problems")]
    says = one_line(found.pop("device_id", ""), 100)
    row["device_id"] = note.device_id or says
    row |= {"status": "done", "reason": "", **found, "problems": "; ".join(problems)[:2000]}
    return Outcome(row, files, "", time.perf_counter() - began)


def _fit(task: Task, place: Path) -> Row:
    from vo2_models.device.description import preset
    from vo2_models.identification.model_fit import fit_model
    from vo2_models.model_file import save_model_parameters

    from vo2_identification.bags import read_recording
    from vo2_identification.bags.problems import in_few_lines
    from vo2_identification.fit import MARK, of_device

    recording, problems = read_recording(task.bag, device=preset(task.device))
    of_device(recording, task.device, Path(task.bag))
    result, parameters = fit_model(
        [recording],
        task.device,
        plays=task.options["plays"],
        names=[task.bag],
        self_sensing=not task.options["simulation_only"],
    )
    save_model_parameters(place / "model.yaml", parameters, comment=f"{MARK} to {task.bag}")
    row: Row = {"start_s": float(recording.time_s[0]), "samples": len(recording)}
    row |= _constants(result.model)
    for channel, sensor in result.model.sensors.items():
        row[f"{channel}.residual"] = sensor.residual
    row["problems"] = [*map(str, in_few_lines(problems)), *result.notes]
    return row


def _constants(model: DeviceModel) -> Row:
    """Constants of a fitted device with their standard deviations, and what its loops look like."""
    row: Row = {}
    device = model.description
    for name, value in model.scalars.items():
        std = model.uncertainty.get(name)
        row[name] = value
        if std:
            row[f"{name}.std"] = std[0]
    cold, hot = sorted(device.steady_temperature(drive) for drive in device.operating_range)
    for section in ("resistance", "deflection"):
        bank: PlayBank = getattr(model, section)
        if bank.present:
            row |= {f"{section}.{name}": value for name, value in _loop(bank, cold, hot).items()}
    return row


def _loop(bank: PlayBank, cold: float, hot: float) -> Row:
    """Span of a law's major loop, where both branches cross its middle, and how far apart; in the law's units."""
    *crossings, span = bank.half_way(cold, hot)
    first, second = (None if math.isnan(at) else at for at in crossings)
    width = None if first is None or second is None else first - second
    return {"loop_span": span, "middle_heating": first, "middle_cooling": second, "loop_width": width}


def _diagnose(task: Task, place: Path) -> Row:
    from vo2_models.device.description import PRESETS
    from vo2_models.device.model import DeviceModel
    from vo2_models.diagnosis.files import write_results
    from vo2_models.diagnosis.pipeline import study

    from vo2_identification.bags import read_recording
    from vo2_identification.bags.problems import in_few_lines

    description = DeviceModel.from_parameters(task.parameters).description
    recordings, problems = [], []
    every = [*task.calibration, task.bag]
    for bag in every:
        recording, found = read_recording(bag, device=description)
        recordings.append(recording)
        problems += [f"{bag}: {problem}" for problem in in_few_lines(found)]
    began = time.perf_counter()
    result = study(recordings[-1:], task.parameters, calibration=recordings[:-1], names=every)
    answer = write_results(result, place, problems=problems, seconds=time.perf_counter() - began)
    row: Row = {"start_s": float(recordings[-1].time_s[0]), "samples": len(recordings[-1])}
    row["verdict"] = answer.verdict
    row["effects"] = " + ".join(
        f"{each.id}:{each.signal}" if each.signal else each.id for each in answer.effects
    )
    row["probability"] = min((each.probability for each in answer.effects), default=None)
    for each in answer.effects:
        for name, estimate in each.parameters.items():
            row[f"{each.id}.{name}"], row[f"{each.id}.{name}.std"] = estimate.value, estimate.std
    for moved in answer.moved:
        row[moved.constant], row[f"{moved.constant}.std"] = moved.now, moved.std
    for channel, fit in answer.fit.items():
        row[f"{channel}.nrmse_before"], row[f"{channel}.nrmse_after"] = fit.nrmse_before, fit.nrmse_after
    row["problems"] = [*(f.text for f in result.reading.findings if f.kind == "device"), *problems]
    row["device_id"] = "" if recordings[-1].device_id in PRESETS else recordings[-1].device_id
    return row
