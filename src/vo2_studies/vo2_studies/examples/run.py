"""One case from its files to its held-out error: convert, describe, fit, predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from vo2_identification.bags import read_recording, write_bag
from vo2_identification.conversion.column_map import read_map
from vo2_identification.conversion.converting import convert_file
from vo2_identification.describe import drafted
from vo2_identification.predict import prediction_page
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.identification.grid import on_grid
from vo2_models.identification.model_fit import fit_model
from vo2_models.model_file import save_model_parameters
from vo2_models.prediction import Prediction, predict
from vo2_models.recording import HEATER_CURRENT, Recording

from vo2_studies.examples.cases import Case, Example, data_files, held_out
from vo2_studies.examples.plain_preisach import PlainPrediction, plain_preisach

__all__ = ["Outcome", "run_case"]


@dataclass(frozen=True)
class Outcome:
    """What a case showed.

    Attributes
    ----------
    example, case : names
    channel, unit : of the response, the unit in which it is judged
    samples : held-out samples
    span : of the held-out response
    error : root mean square of measured minus predicted there
    inside : share of the held-out samples within the 95 % bounds
    plain : the yardstick on the same samples
    notes : of the fit
    prediction : of the last recording, for the picture
    model : the fitted model
    """

    example: str
    case: str
    channel: str
    unit: str
    samples: int
    span: float
    error: float
    inside: float
    plain: PlainPrediction
    notes: tuple[str, ...]
    prediction: Prediction
    model: DeviceModel

    @property
    def ratio(self) -> float:
        """Error over that of the yardstick."""
        return self.error / self.plain.error


def run_case(example: Example, case: Case, data: Path, output: Path) -> Outcome:
    """Convert, describe, fit and predict; write bags, device draft, model and page below `output`.

    Raises
    ------
    ValueError : a file that is not there or cannot be used; one line.
    """
    device = preset(example.folder / "device.yaml")
    column_map = read_map(example.folder / "map.yaml")
    place = output / f"{example.folder.name}_{case.name}"

    def recorded(names: Sequence[str], kind: str) -> list[Recording]:
        found = []
        for path in data_files(example, data, names):
            (converted,) = convert_file(path, column_map)
            bag = write_bag(place / kind / converted.name, converted.recording)
            found.append(read_recording(bag, device=device)[0])
        return found

    calibration = recorded(case.calibrate, "calibration")
    others = recorded(case.predict, "predicted")
    (response,) = device.responses
    role = response.role
    hidden = [held_out(r[HEATER_CURRENT], case.hold) for r in calibration] if case.hold else []
    given = (
        [
            replace(r, channels={**r.channels, role: np.where(hide, np.nan, r[role])})
            for r, hide in zip(calibration, hidden, strict=True)
        ]
        if hidden
        else calibration
    )
    draft, doubts = drafted(device.in_channels(given[0]), device.drive_channel)
    head = "".join(f"# {doubt}\n" for doubt in doubts)
    (place / "draft.yaml").write_text(head + yaml.safe_dump(draft, sort_keys=False), encoding="utf-8")
    result, parameters = fit_model(given, device.key, names=case.calibrate)
    save_model_parameters(place / "model.yaml", parameters)
    model = DeviceModel.load(place / "model.yaml")
    judged = calibration if hidden else others
    predictions = [predict(model, recording) for recording in judged]
    (place / "report.html").write_text(prediction_page(predictions[-1], model), encoding="utf-8")
    gaps, inside, values = [], [], []
    for k, (recording, one) in enumerate(zip(judged, predictions, strict=True)):
        grid = on_grid(recording)
        where = np.isfinite(grid.measured[role])
        if hidden:
            # the regular grid may have more samples than the recording
            where &= np.interp(one.time_s, recording.time_s, hidden[k].astype(float)) > 0.5
        channel = one.channels[role]
        shown = -np.log10(channel.value) if role == "film_resistance" else channel.value
        measured = 10.0 ** -grid.measured[role] if role == "film_resistance" else grid.measured[role]
        gaps.append((grid.measured[role] - shown)[where])
        values.append(grid.measured[role][where])
        inside.append(((measured >= channel.lower) & (measured <= channel.upper))[where])
    gap, value = np.concatenate(gaps), np.concatenate(values)
    grids = [on_grid(recording) for recording in (calibration if hidden else [*calibration, *others])]
    marks = (
        [np.interp(g.start + g.dt * np.arange(g.current.size), r.time_s, h.astype(float)) > 0.5
         for g, r, h in zip(grids, calibration, hidden, strict=True)]
        if hidden
        else [np.full(g.current.size, k >= len(calibration)) for k, g in enumerate(grids)]
    )  # fmt: skip
    plain = plain_preisach([g.current for g in grids], [g.measured[role] for g in grids], marks, grids[0].dt)
    return Outcome(
        example=example.folder.name,
        case=case.name,
        channel=response.channel,
        unit=f"log10 {response.unit}" if role == "film_resistance" else response.unit,
        samples=gap.size,
        span=float(np.ptp(value)),
        error=float(np.sqrt(np.mean(gap**2))),
        inside=float(np.mean(np.concatenate(inside))),
        plain=plain,
        notes=result.notes,
        prediction=predictions[-1],
        model=model,
    )
