"""`predict`: what a fitted model expects of a recording or a drive, with bounds, as table, bag and page."""

from __future__ import annotations

import argparse
import csv
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, RESISTANCE, Recording
from vo2_models.units import shown_unit

if TYPE_CHECKING:
    from vo2_models.device.description import DeviceDescription
    from vo2_models.device.model import DeviceModel
    from vo2_models.prediction import ChannelPrediction, Prediction

from vo2_models.command_line import refuse

__all__ = ["RESULTS", "main", "predicted_recording", "prediction_page"]

_DESCRIPTION = """
Run a fitted model on the drive of a bag, of a table, or on one that is written down, and write the responses that it
expects, with bounds by what the fit missed of held-out parts of its calibration. Responses that the bag or the table has are
compared.
"""
RESULTS = ("prediction.csv", "bag", "report.html")
"""What the command writes into its folder."""
_FEW_INSIDE = 0.9
"""Share of the samples within the bounds below which these are told to be too narrow."""
_BOUNDS = (
    "bounds: 1.96 times noise and what the fit missed of held-out parts of its calibration, more of it where a loop is steep. "
    "Fewer than 95 % of the samples lie between them on small loops within the range, in a closed loop, where the calibration "
    "has not been, and once the device has changed"
)
_BEYOND = 1e-3
"""Share of its range by which a drive may be read beyond its limits."""
_TIME = ("time_s", "time")


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C.

    Parameters
    ----------
    args : arguments of the command line; those of the process by default
    """
    options = _parser().parse_args(_with_drive_joined(sys.argv[1:] if args is None else args))
    try:
        return _run(options)
    except (ValueError, OSError) as error:
        return refuse("predict", error)
    except KeyboardInterrupt:
        print("predict: interrupted", file=sys.stderr)
        return 130


def _with_drive_joined(args: Sequence[str]) -> list[str]:
    """The arguments with levels that begin below 0 joined to their option: argparse would take them for another option."""
    joined = list(args)
    for k in range(len(joined) - 1, 0, -1):
        if joined[k - 1] == "--drive" and re.match(r"-[\d.]", joined[k]):
            joined[k - 1 : k + 1] = [f"--drive={joined[k]}"]
    return joined


def _run(options: argparse.Namespace) -> int:
    from vo2_models.device.model import DeviceModel
    from vo2_models.io.output_folder import OutputFolder
    from vo2_models.prediction import predict

    from vo2_identification.bags import write_bag

    outputs = OutputFolder(options.output, RESULTS)
    outputs.check()
    model = DeviceModel.load(options.model)
    device = model.description
    prediction = predict(model, _recording(options, device))
    found = predicted_recording(prediction, device)
    with outputs.replaced() as folder:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "prediction.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["time_s", *found.channels])
            writer.writerows(np.column_stack([found.time_s, *found.channels.values()]).tolist())
        write_bag(folder / "bag", found)
        (folder / "report.html").write_text(prediction_page(prediction, model), encoding="utf-8")
    for line in summary(prediction, device):
        print(line)
    print(f"wrote {', '.join(str(options.output / name) for name in RESULTS)}")
    return 0


def predicted_recording(prediction: Prediction, device: DeviceDescription) -> Recording:
    """Return drive, predicted responses and their bounds under the device's own channel names.

    Parameters
    ----------
    prediction : in roles
    device : whose channel names are used
    """
    channels = {device.drive_channel: prediction.drive}
    for role, one in prediction.channels.items():
        name = device.names[role]
        channels |= {name: one.value, f"{name}_lower": one.lower, f"{name}_upper": one.upper}
        if one.measured is not None:
            channels[f"{name}_measured"] = one.measured
    return Recording(prediction.time_s, channels, device.id)


def summary(prediction: Prediction, device: DeviceDescription) -> list[str]:
    """Return one sentence per response, and what speaks against trusting it."""
    poor = any(one.inside < _FEW_INSIDE for one in prediction.channels.values())
    lines = (
        [f"the recording does not fit the model: {doubt}" for doubt in _doubts(prediction, device)]
        if poor
        else []
    )
    low, high = sorted(device.current_range)
    least, most = (float(f(prediction.drive)) for f in (np.nanmin, np.nanmax))
    beyond = _BEYOND * (high - low)  # a drive is read back with noise
    if least < low - beyond or most > high + beyond:
        lines.append(
            f"{device.drive_channel}: from {least:.4g} to {most:.4g} {device.drive_unit}, beyond the limits {low:g} to "
            f"{high:g} of device {device.id}: what it does there is not known"
        )
    if prediction.late:
        when = f"{abs(prediction.late):.4g} s {'after' if prediction.late > 0.0 else 'before'}"
        lines.append(
            f"{device.drive_channel}: taken to act {when} where it stands in the recording, as the responses show"
        )
    for role, one in prediction.channels.items():
        name, (unit, factor) = device.names[role], shown_unit(device.units[role])
        ends = factor * np.array([np.min(one.value), np.max(one.value)])
        text = f"{name}: predicted {ends[0]:.4g} to {ends[1]:.4g} {unit}"
        if np.isfinite(one.error):
            judged = f"log10 {unit}" if role == RESISTANCE else unit
            text += (
                f"; measured minus predicted {factor * one.error:.3g} {judged} r.m.s., {100 * one.error / one.span:.2f} % of the "
                f"measured span; {100 * one.inside:.0f} % of the samples within the bounds"
            )
            if one.inside < _FEW_INSIDE:
                text += ": the model misses more here than of its calibration"
            if one.unknown:
                text += (
                    f"; its first {one.unknown} samples, until {device.drive_channel} has been at an end of its range, begin "
                    "at a state that the drive does not show, and are not judged"
                )
        lines.append(text)
    return [*lines, _BOUNDS]


def _doubts(prediction: Prediction, device: DeviceDescription) -> list[str]:
    """What only a mistake makes of a recording, as `diagnose` refuses it: a unit, a column or a sign that is another one."""
    from vo2_models.diagnosis.consistency import runs_against
    from vo2_models.diagnosis.limits import Limits
    from vo2_models.diagnosis.nominal import judged
    from vo2_models.identification.plausibility import doubts

    seen, pairs = {HEATER_CURRENT: prediction.drive}, {}
    for role, one in prediction.channels.items():
        if one.measured is not None:
            seen[role], values = one.measured, judged(role, one.measured)
            good = np.isfinite(values)
            pairs[role] = (values[good], judged(role, one.value)[good])
    told = doubts(Recording(prediction.time_s, seen, device.id), device.key)
    return told or [device.in_own_names(text) for text in [runs_against(pairs, Limits())] if text]


def prediction_page(prediction: Prediction, model: DeviceModel) -> str:
    """Return the page: each response over the time and over the drive.

    Parameters
    ----------
    prediction : in roles
    model : that made it
    """
    from vo2_models.page.figures import COLOURS, drawn, figure_html, new_figure
    from vo2_models.page.page import page, paragraph, section

    device = model.description
    sections = []
    for role, shown in prediction.channels.items():
        name, (unit, factor) = device.names[role], shown_unit(device.units[role])
        judged = shown.measured is not None
        gap = () if shown.measured is None else (shown.measured, shown.measured - shown.value)
        some = drawn(prediction.drive, shown.value, *gap)
        time_s, drive = prediction.time_s[some], prediction.drive[some]
        one = replace(
            shown,
            value=factor * shown.value[some],
            lower=factor * shown.lower[some],
            upper=factor * shown.upper[some],
            measured=factor * shown.measured[some] if shown.measured is not None else None,
        )
        with new_figure(height_in=4.4 if judged else 3.2) as figure:
            heights = (3, 1) if judged else (1,)
            places = figure.subplot_mosaic(
                "cl;dl" if judged else "cl", width_ratios=(2, 1), height_ratios=heights
            )
            course, loop = places["c"], places["l"]
            for axes, x in ((course, time_s), (loop, drive)):
                if one.measured is not None:
                    axes.plot(x, one.measured, color=COLOURS["true"], label="measured")
                axes.plot(x, one.value, color=COLOURS["fit"], linestyle="--", label="predicted")
                axes.set_yscale("log" if role == RESISTANCE else "linear")
            course.fill_between(time_s, one.lower, one.upper, color=COLOURS["fit"], alpha=0.2, label="bounds")
            if judged:
                _residual(
                    places["d"],
                    time_s,
                    one,
                    f"log10 {unit}" if role == RESISTANCE else unit,
                )
                course.tick_params(labelbottom=False)
                places["d"].sharex(course)
            places["d" if judged else "c"].set_xlabel("time [s]")
            course.set_ylabel(f"{name} [{unit}]")
            loop.set_xlabel(f"{device.drive_channel} [{device.drive_unit}]")
            figure.legend(*course.get_legend_handles_labels(), loc="outside upper right", ncols=3)
        sections.append(
            section(name, figure_html(figure, f"{name} over the time and over the drive, device {device.id}"))
        )
    start = "settled at its first drive" if prediction.settled else "from a cold rest"
    lead = f"What the fitted model of device {device.id} expects, started {start}."
    found = [paragraph(line) for line in summary(prediction, device)]
    return page(f"Prediction, {device.id}", lead, [section("Result", *found), *sections])


def _residual(axes: Any, time_s: NDArray[np.float64], one: ChannelPrediction, unit: str) -> None:
    """Draw measured minus predicted, and the bounds about it."""
    from vo2_models.page.figures import COLOURS

    of: Callable[[NDArray[np.float64]], NDArray[np.float64]] = (
        np.log10 if unit.startswith("log10") else np.asarray
    )
    axes.fill_between(
        time_s, of(one.lower) - of(one.value), of(one.upper) - of(one.value), color=COLOURS["fit"], alpha=0.2
    )
    if one.measured is not None:
        axes.plot(time_s, of(one.measured) - of(one.value), color=COLOURS["true"])
    axes.set_ylabel(f"difference\n[{unit}]")


def _recording(options: argparse.Namespace, device: DeviceDescription) -> Recording:
    """The drive, with measured responses where there are some, in roles."""
    if options.bag is not None:
        from vo2_models.device.description import PRESETS
        from vo2_models.identification.plausibility import undriven

        from vo2_identification.bags import read_recording
        from vo2_identification.bags.problems import in_few_lines

        recording, problems = read_recording(options.bag, device=device)
        for problem in in_few_lines(problems):
            print(f"predict: {options.bag}: {problem}", file=sys.stderr)
        if recording.device in PRESETS and recording.device != device.id:
            raise ValueError(
                f"{options.bag}: was recorded on device {recording.device!r}, the model is of {device.id!r}; give the model of "
                "this device"
            )
        if COMMANDED_CURRENT not in recording and (told := undriven(recording, device.key)):
            raise ValueError(f"{options.bag}: {told}")
        return recording
    if options.csv is not None:
        return device.in_roles(_table(options.csv, device))
    from vo2_models.identification.excitation import Excitation

    levels = _levels(options.drive)
    period = options.period or device.sample_period
    rate = options.rate or float(np.sum(np.abs(np.diff(levels)))) / (1000.0 * period)
    drive = Excitation.at_rate(levels, rate_per_s=rate).sample(period)
    return device.in_roles(
        Recording(period * np.arange(drive.size, dtype=np.float64), {device.drive_channel: drive}, device.id)
    )


def _table(path: Path, device: DeviceDescription) -> Recording:
    """Read a table with a header of channel names and a column of the time in seconds."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = list(csv.reader(file))
    names = [cell.strip() for cell in rows[0]] if rows else []
    time = next((name for name in _TIME if name in names), "")
    if not time or device.drive_channel not in names:
        raise ValueError(
            f"{path}: found the columns {', '.join(names) or 'none'}, need {_TIME[0]} and {device.drive_channel} "
            "in the first row; or make a bag of it with `convert`"
        )
    known = [name for name in names if name == time or name in device.names.values()]
    values = np.full((len(rows) - 1, len(known)), np.nan)
    for number, row in enumerate(rows[1:]):
        for place, name in enumerate(known):
            cell = row[names.index(name)].strip() if names.index(name) < len(row) else ""
            try:
                values[number, place] = float(cell) if cell else np.nan
            except ValueError:
                raise ValueError(f"{path}: row {number + 2}, {name}: found {cell!r}, need a number") from None
    columns = dict(zip(known, values.T, strict=True))
    stamps = np.asarray(columns.pop(time), dtype=np.float64)
    return Recording(stamps, columns, device.id)


def _levels(text: str) -> np.ndarray:
    try:
        levels = np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise ValueError(f"--drive: found {text!r}, need levels such as 0,100,20,100,0") from None
    if levels.size < 2:
        raise ValueError(f"--drive: found {levels.size} level, need at least two")
    return levels


def _parser() -> argparse.ArgumentParser:
    from vo2_models.effects.catalogue import add_effects_option

    parser = argparse.ArgumentParser(prog="predict", description=_DESCRIPTION, allow_abbrev=False)
    add_effects_option(parser)
    parser.add_argument("--model", type=Path, required=True, help="model file that `fit` wrote")
    given = parser.add_mutually_exclusive_group(required=True)
    given.add_argument("--bag", type=Path, help="bag with the drive, and responses to compare with")
    given.add_argument("--csv", type=Path, help="table with columns time_s and channel names, in SI units")
    given.add_argument(
        "--drive", metavar="LEVELS", help="levels of the drive, visited in turn: 0,100,20,100,0"
    )
    parser.add_argument(
        "--rate",
        type=float,
        help="of --drive, in its unit per second (default: 1000 samples for the whole way)",
    )
    parser.add_argument("--period", type=float, help="sample period of --drive [s] (default: the device's)")
    parser.add_argument("--output", type=Path, required=True, help="folder for table, bag and page")
    return parser


if __name__ == "__main__":
    sys.exit(main())
