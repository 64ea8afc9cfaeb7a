"""`fit`: from calibration bags to the complete fitted simulation of a device, as a model file."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION, Recording

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from vo2_models.device import DeviceModel
    from vo2_models.identification.device_fit import FitResult
    from vo2_models.parameters import Value

    Floats = NDArray[np.float64]

__all__ = ["main", "model_of"]

_DESCRIPTION = """
Fit driver, thermal model, resistance, deflection and sensors of a device to one or more bags of a quasi-static recording
(a damped oscillation), and write the model file that plant, estimator, controller and feedforward load. The uncertainty
of each parameter and the residual of each channel stand in the file.
"""
_UNITS = {
    RESISTANCE: ("log10 ohm", 1.0),
    TIP_DEFLECTION: ("um", 1e6),
    STAGE_TEMPERATURE: ("K", 1.0),
}


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C."""
    options = _parser().parse_args(args)
    try:
        return _run(options)
    except KeyboardInterrupt:
        print(f"fit: interrupted; {options.output} is not written", file=sys.stderr)
        return 130


def _run(options: argparse.Namespace) -> int:
    from vo2_models.device.description import preset
    from vo2_models.model_file import save_model_parameters

    from vo2_identification.bags import read_recording
    from vo2_identification.bags.problems import in_few_lines

    begun = time.monotonic()
    try:
        device = preset(options.device)
        _check_place(options.output)
        recordings = []
        for bag in options.bag:
            recording, problems = read_recording(bag, device=device)
            for problem in in_few_lines(problems):
                print(f"fit: {bag}: {problem}", file=sys.stderr)
            recordings.append(_of_device(recording, options.device, bag))
        names = [str(bag) for bag in options.bag]
        result, parameters = model_of(
            recordings,
            options.device,
            plays=options.plays,
            quiet=options.quiet,
            names=names,
            self_sensing=not options.simulation_only,
        )
        save_model_parameters(options.output, parameters, comment=f"fitted by `fit` to {', '.join(names)}")
    except ValueError as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(f"{options.output}: cannot be written ({error.strerror or error})")
    for line in _summary(result):
        print(line)
    print(f"wrote {options.output} in {time.monotonic() - begun:.1f} s")
    return 0


def model_of(
    recordings: Sequence[Recording],
    device: str,
    *,
    plays: int,
    quiet: bool = True,
    names: Sequence[str] = (),
    self_sensing: bool = True,
) -> tuple[FitResult, dict[str, Value]]:
    """Fit a device and what builds on it; return the fit and all flat `model.*` parameters.

    Parameters
    ----------
    recordings : calibration recordings of one device
    device : preset id
    plays : plays of each channel's loop
    quiet : whether to leave out the progress on standard error
    names : of the recordings, for the messages
    self_sensing : whether to fit the laws of self-sensing too, which `estimator` needs and `diagnose` does not

    Raises
    ------
    ValueError : recordings that cannot be fitted; the message says why.
    """
    from vo2_models.identification.calibration_check import check_calibration, judge_fit
    from vo2_models.identification.device_fit import fit_device
    from vo2_models.self_sensing.characterise import characterise

    began = time.monotonic()

    def progress(text: str, share: float) -> None:
        if not quiet:
            took = time.monotonic() - began
            rest = f", about {took * (1 - share) / share:.0f} s left" if share > 0.05 else ""
            print(f"fit: {100 * share:3.0f} %  {text}{rest}", file=sys.stderr)

    recordings, notes = check_calibration(recordings, device, names=names)
    result = fit_device(recordings, device, plays=plays, progress=progress)
    result = replace(result, notes=(*notes, *result.notes, *judge_fit(result, recordings)))
    parameters = result.model.to_parameters()
    both = [r for r in recordings if RESISTANCE in r and TIP_DEFLECTION in r]
    if both:
        if self_sensing:
            progress("self-sensing", 0.95)
            parameters |= characterise(max(both, key=len), parameters)
        parameters |= _digest(result, recordings[0], both[0] is recordings[0])
    return result, parameters


def _digest(result: FitResult, recording: Recording, first: bool) -> dict[str, Value]:
    """What the loops left over along the first recording, for a later diagnosis; nothing where it has no cold start."""
    import numpy as np
    from vo2_models.diagnosis.reading import current_reading
    from vo2_models.identification.digest import digest_of
    from vo2_models.identification.enrichment import EnrichmentBasis

    stop = result.ends[0]
    path, gap, tip = (
        values[1:stop]
        for values in (result.path, result.residuals[RESISTANCE], result.residuals[TIP_DEFLECTION])
    )
    if not first or result.settled or path.size < 100:
        return {}
    basis = EnrichmentBasis()
    reach = basis.half_width_k
    inside = (basis.centre_degc[0] - reach, basis.centre_degc[1] + reach)
    # the model's y is -log10 R
    short = digest_of(path, -gap, tip, inside_degc=inside)
    stage = result.residuals.get(STAGE_TEMPERATURE)
    reading, noise = current_reading(recording)
    return replace(
        short,
        current_reading=reading,
        noise_current=noise,
        noise_log_resistance=_noise(path, gap, result, RESISTANCE),
        noise_deflection=_noise(path, tip, result, TIP_DEFLECTION),
        noise_stage=() if stage is None else _noise(path, stage[1:stop], result, STAGE_TEMPERATURE),
        by_lag={
            name: np.column_stack([means.log_resistance, means.deflection])
            for name, columns in _by_lag(result.model, recording).items()
            for means in [digest_of(path, *columns, inside_degc=inside)]
        },
    ).to_parameters()


def _by_lag(model: DeviceModel, recording: Recording) -> dict[str, tuple[Floats, Floats]]:
    """Change of log10 R and of the deflection along a recording by each lag of the model, per second, the loops held."""
    import numpy as np
    from vo2_models.identification.digest import LAGS
    from vo2_models.identification.grid import on_grid

    grid = on_grid(recording)
    step = 0.01 * model.scalars["thermal.time_constant"]

    def simulated(scalars: Mapping[str, float]) -> tuple[Floats, Floats]:
        out = replace(model, scalars=dict(scalars)).simulation.run(grid.current, dt=grid.dt)
        return np.log10(out[:, 1]), out[:, 2]

    before = simulated(model.scalars)
    found = {}
    for name in LAGS:
        after = simulated({**model.scalars, name: model.scalars[name] + step})
        found[name] = ((after[0] - before[0]) / step, (after[1] - before[1]) / step)
    return found


def _noise(path: Floats, residual: Floats, result: FitResult, channel: str) -> tuple[float, ...]:
    """Innovation and colour of a channel's noise: of what even a richer loop shape leaves of the residual."""
    import numpy as np
    from vo2_models.diagnosis.noise import fit_noise
    from vo2_models.diagnosis.nominal import basis_of, span_of

    device = result.model.device
    good = np.isfinite(residual)
    if np.count_nonzero(good) < 100:
        return ()
    left = np.where(good, residual, 0.0)
    sensor = result.model.sensors.get(channel)
    level = sensor.noise / (np.log(10.0) if channel == RESISTANCE else 1.0) if sensor else 0.0
    if channel != STAGE_TEMPERATURE and level > 0.0:
        features = basis_of(device).features(path, span=span_of(device)[channel])
        used = features[good] / level
        gram = used.T @ used
        gram[np.diag_indices_from(gram)] += 1.0
        left[good] -= level * (used @ np.linalg.solve(gram, used.T @ (left[good] / level)))
    found = fit_noise(left, good)
    return found.innovation, *found.ar


def _of_device(recording: Recording, device: str, bag: Path) -> Recording:
    """Refuse a bag of another known device."""
    from vo2_models.device.description import PRESETS, preset

    if recording.device in PRESETS and recording.device != preset(device).id:
        raise ValueError(
            f"{bag}: was recorded on device {recording.device}, need --device {recording.device}"
        )
    return recording


def _check_place(output: Path) -> None:
    """Refuse before the work what could not be written after it."""
    if output.is_dir():
        raise ValueError(f"{output}: is a folder, need the name of a file, such as {output / 'model.yaml'}")
    parent = next((folder for folder in output.absolute().parents if folder.exists()), None)
    if parent is None or not parent.is_dir() or not os.access(parent, os.W_OK):
        raise ValueError(f"{output}: cannot be written ({parent} is not a folder that may be written into)")


def _summary(result: FitResult) -> list[str]:
    from vo2_models.identification.calibration_check import noise_level

    lines = []
    for channel, sensor in result.model.sensors.items():
        unit, factor = _UNITS[channel]
        noise = factor * noise_level(channel, sensor.noise)
        relative = f" ({100 * sensor.noise:.2g} % of the value)" if channel == RESISTANCE else ""
        lines.append(
            f"{channel}: residual {factor * sensor.residual:.3g} {unit} r.m.s., noise {noise:.3g} {unit}{relative}"
        )
    for name, unit in (
        ("thermal.time_constant", "s"),
        ("driver.dead_time", "s"),
        ("thermal.ambient", "degC"),
        ("thermal.linear_gain", "K/A"),
    ):
        std = result.model.uncertainty.get(name)
        if std:
            lines.append(f"{name}: {result.model.scalars[name]:.5g} +- {std[0]:.2g} {unit}")
    return lines + [f"note: {note}" for note in result.notes]


def _refuse(message: str) -> int:
    print(f"fit: {message}", file=sys.stderr)
    return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="fit", description=_DESCRIPTION)
    parser.add_argument(
        "--bag", type=Path, action="append", required=True, help="bag to fit; may be repeated"
    )
    parser.add_argument(
        "--device", required=True, help="device: integrated, peltier, or the path of a device file"
    )
    parser.add_argument("--output", type=Path, required=True, help="model file to write (YAML)")
    parser.add_argument("--plays", type=_plays, default=12, help="plays of each channel's loop (default 12)")
    parser.add_argument(
        "--simulation-only",
        action="store_true",
        help="leave out the laws of self-sensing, which `estimator` needs and `diagnose` does not: half the time",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
    return parser


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
