"""`fit`: from calibration bags to the complete fitted simulation of a device, as a model file."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

if TYPE_CHECKING:
    from vo2_models.identification.device_fit import FitResult

from vo2_models.command_line import Progress, refuse

__all__ = ["MARK", "main", "of_device"]

_DESCRIPTION = """
Fit driver, thermal model, resistance, deflection and sensors of a device to one or more bags of a quasi-static recording
(a damped oscillation), and write the model file that plant, estimator, controller and feedforward load. The uncertainty
of each parameter and the residual of each channel stand in the file.
"""
MARK = "fitted by `fit`"
"""Begins the first line of a model file that this command may replace."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C.

    Parameters
    ----------
    args : command line, None for that of the process
    """
    parser = _parser()
    options = parser.parse_args(args)
    if bool(options.bag) == bool(options.bags):
        parser.error("need --bag BAG, which may be repeated, or --bags FOLDER")
    if options.bags and options.gap_limit is not None:
        parser.error("--gap-limit is of --bag")
    if options.bags and options.law:
        parser.error("--law is of --bag")
    try:
        return _run_folder(options) if options.bags else _run(options)
    except KeyboardInterrupt:
        print(f"fit: interrupted; {options.output} is not written", file=sys.stderr)
        return 130


def _run(options: argparse.Namespace) -> int:
    from vo2_models.device.description import preset
    from vo2_models.identification.loop_law import LAW_CHOICES
    from vo2_models.identification.model_fit import fit_model
    from vo2_models.model_file import check_model_place, save_model_parameters
    from vo2_models.self_sensing.records import COMPOSITE

    from vo2_identification.bags import read_recording
    from vo2_identification.bags.problems import in_few_lines

    begun = time.monotonic()
    progress = Progress("fit", quiet=options.quiet)
    try:
        if options.law and options.law not in LAW_CHOICES:
            raise ValueError(f"--law: found {options.law!r}, need one of {', '.join(LAW_CHOICES)}")
        device = preset(options.device)
        plays = _plays_of(options)
        check_model_place(options.output, MARK)
        recordings = []
        for bag in options.bag:
            recording, problems = read_recording(bag, device=device)
            for problem in in_few_lines(problems):
                print(f"fit: {bag}: {problem}", file=sys.stderr)
            recordings.append(of_device(recording, options.device, bag))
            if not {HEATER_CURRENT, COMMANDED_CURRENT} & set(recording.channels):
                raise ValueError(
                    f"{bag}: found no {device.drive_channel}, the drive of device {device.id}; is it of another device?"
                )
        names = [str(bag) for bag in options.bag]
        result, parameters = fit_model(
            recordings,
            options.device,
            plays=plays,
            progress=lambda text, share: progress(share, text),
            names=names,
            self_sensing=not options.simulation_only,
            law=options.law,
            gap_limit=options.gap_limit,
        )
        progress.clear()
        save_model_parameters(options.output, parameters, comment=f"{MARK} to {', '.join(names)}")
    except ValueError as error:
        return refuse("fit", error)
    except OSError as error:
        return refuse("fit", f"{options.output}: cannot be written ({error.strerror or error})")
    for line in _summary(result):
        print(line)
    if count := np.size(parameters.get(f"{COMPOSITE}.resistance.weights", ())) * bool(options.law):
        print(
            f"self-sensing: law {options.law} is that of the simulation; the estimate of the estimator does not depend on --law, "
            f"its laws are fitted apart (composite: {count} plays)"
        )
    print(f"wrote {options.output} in {time.monotonic() - begun:.1f} s")
    return 0


def _run_folder(options: argparse.Namespace) -> int:
    from vo2_identification.batch import fit_folder

    try:
        options.plays = _plays_of(options)
        return fit_folder(options)
    except ValueError as error:
        return refuse("fit", error)
    except OSError as error:
        return refuse(
            "fit", f"{error.filename or options.output}: cannot be written ({error.strerror or error})"
        )


def _plays_of(options: argparse.Namespace) -> int:
    """Return the number of plays; refuse one that is given for a law without plays, or where held-out parts choose it."""
    from vo2_models.device.description import preset
    from vo2_models.hysteresis.law_fit import OF_PLAYS
    from vo2_models.hysteresis.law_fit import PLAYS as COUNT
    from vo2_models.identification.loop_law import AUTO, PLAYS

    device = preset(options.device)
    taken = (*OF_PLAYS, *((PLAYS, AUTO) if device.has_body else ()))
    if options.plays is None:
        return COUNT
    if (options.law or (PLAYS if device.has_body else "")) not in taken:
        what = f"law {options.law}" if options.law else "the law that held-out parts choose"
        raise ValueError(
            f"--plays: found {options.plays} with {what} on device {device.id}, need one of --law {', '.join(taken)}; "
            "or leave --plays out"
        )
    return int(options.plays)


def of_device(recording: Recording, device: str, bag: Path) -> Recording:
    """Return the recording; refuse that of another known device.

    Parameters
    ----------
    recording : of the bag
    device : that the command was given
    bag : for the message

    Raises
    ------
    ValueError : names both devices.
    """
    from vo2_models.device.description import PRESETS, preset

    if recording.device in PRESETS and recording.device != preset(device).id:
        raise ValueError(
            f"{bag}: was recorded on device {recording.device}, need --device {recording.device}"
        )
    return recording


def _summary(result: FitResult) -> list[str]:
    from vo2_models.hysteresis import PlayBank
    from vo2_models.identification.calibration_check import noise_level

    lines, device = [], result.model.description
    for role, sensor in result.model.sensors.items():
        unit = "K" if role == STAGE_TEMPERATURE else device.units.get(role, "")
        unit = f"log10 {unit}" if role == RESISTANCE else unit
        unit, factor = ("um", 1e6) if unit == "m" else (unit, 1.0)
        noise = factor * noise_level(role, sensor.noise)
        relative = f" ({100 * sensor.noise:.2g} % of the value)" if role == RESISTANCE else ""
        lines.append(
            f"{device.names.get(role, role)}: residual {factor * sensor.residual:.3g} {unit} r.m.s., "
            f"noise {noise:.3g} {unit}{relative}"
        )
    for name, unit in (
        ("thermal.time_constant", "s"),
        ("driver.dead_time", "s"),
        ("thermal.ambient", "degC"),
        ("thermal.linear_gain", f"K/{device.drive_unit}"),
    ):
        std = result.model.uncertainty.get(name)
        if std:
            line = f"{name}: {result.model.scalars[name]:.5g} +- {std[0]:.2g} {unit}"
            if name == "thermal.time_constant" and not device.has_body:
                line += (
                    ", if the drive is held over a sample (half a sample period less if it goes straight) and the law is right: "
                    "creep, or a residual of many times the noise, can move it by far more"
                )
            lines.append(line)
    if device.has_body:
        for role, law in ((RESISTANCE, result.model.resistance), (TIP_DEFLECTION, result.model.deflection)):
            if isinstance(law, PlayBank) and law.present:
                ends = [device.steady_temperature(drive) for drive in device.operating_range]
                rising, falling, _ = law.half_way(min(ends), max(ends))
                if math.isfinite(rising - falling):
                    name = device.names.get(role, role)
                    lines.append(f"loop of {name}: {rising - falling:.3g} K wide at half its height")
    return lines + [f"note: {note}" for note in result.notes]


class _Parser(argparse.ArgumentParser):
    """Names the laws that there are in its help alone: they take a second to load."""

    def format_help(self) -> str:
        from vo2_models.identification.loop_law import LAW_CHOICES
        from vo2_models.self_sensing.composite_fit import PLAYS as COMPOSITE_PLAYS

        self.epilog = (
            f"laws: {', '.join(LAW_CHOICES)}. On a device with a heated body the estimate of the estimator does not depend on "
            f"LAW: its laws of self-sensing are fitted apart, those of kind composite with {COMPOSITE_PLAYS} plays."
        )
        return super().format_help()


def _parser() -> argparse.ArgumentParser:
    from vo2_models.effects.catalogue import add_effects_option

    from vo2_identification.batch import add_batch_options

    parser = _Parser(prog="fit", description=_DESCRIPTION)
    add_effects_option(parser)
    parser.add_argument(
        "--bag",
        type=Path,
        action="append",
        help="bag to fit; may be repeated: one device, fitted to all of them",
    )
    add_batch_options(parser)
    parser.add_argument(
        "--device",
        required=True,
        help="device: integrated, peltier, peltier_chapter8, or the path of a device file",
    )
    parser.add_argument(
        "--output", type=Path, required=True, help="model file to write (YAML); with --bags a folder"
    )
    parser.add_argument(
        "--plays",
        type=_plays,
        help="plays of each channel's loop, or of law gpi or egpi (default 12); without a heated body of these two alone",
    )
    parser.add_argument(
        "--law",
        default="",
        metavar="LAW",
        help="with --bag: hysteresis law of the simulation (not of self-sensing), one of those below: cs is a sparse Preisach "
        "density (compressive sensing), auto the one that predicts held-out parts best "
        "(default: plays; without a heated body plays, preisach or bounded_plays, by held-out error)",
    )
    parser.add_argument(
        "--simulation-only",
        action="store_true",
        help="leave out the laws of self-sensing that the estimator's kinds combined, preisach, egpi and polynomial need: half "
        "the time",
    )
    parser.add_argument(
        "--gap-limit",
        type=_share,
        metavar="SHARE",
        help="with --bag: fit a recording of which up to this share is gaps, and whose clock may be irregular (default: 0.3, as "
        "diagnose, and a regular clock): what the device did in a gap is lost, and the loops are wrong by it",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
    return parser


def _share(text: str) -> float:
    try:
        share = float(text)
    except ValueError:
        share = math.nan
    if not 0.0 <= share <= 1.0:
        raise argparse.ArgumentTypeError(f"found {text!r}, need a share from 0 to 1")
    return share


def _plays(text: str) -> int:
    try:
        count = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"found {text!r}, need a whole number from 2 to 40") from None
    if not 2 <= count <= 40:
        raise argparse.ArgumentTypeError(f"found {count}, need 2 to 40")
    return count


if __name__ == "__main__":
    sys.exit(main())
