"""The command `diagnose`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from vo2_models.command_line import Progress, refuse
from vo2_models.io import OutputFolder

if TYPE_CHECKING:
    from vo2_models.diagnosis.result import Diagnosis, NextExperiment
    from vo2_models.parameters import Value

__all__ = ["continue_with_next", "diagnose_bags", "main"]

_SAY_S = 10.0
"""Time before the first line of progress, and between two, where there is no terminal [s]."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0 whatever was found, 2 on unusable input, 130 after Ctrl-C.

    Parameters
    ----------
    arguments : command line, None for that of the process
    """
    from vo2_models.effects.catalogue import add_effects_option

    from vo2_identification.batch import add_batch_options

    parser = argparse.ArgumentParser(
        prog="diagnose",
        description="Compare recordings with a fitted simulation: where they differ, what physics was left out, "
        "a corrected model, and what to record next.",
    )
    parser.add_argument(
        "--bag", action="append", metavar="BAG", help="a recording; may be repeated: taken together"
    )
    add_batch_options(parser)
    parser.add_argument(
        "--model", required=True, metavar="MODEL.yaml", help="what `fit` wrote for this device"
    )
    parser.add_argument(
        "--calibration",
        action="append",
        default=[],
        metavar="BAG",
        help="a recording that the model was fitted to, where what is looked for may have been there already: nominal "
        "device and effect are fitted together over all bags; may be repeated",
    )
    parser.add_argument("--output", required=True, metavar="DIR", help="where the results go")
    parser.add_argument(
        "--next",
        action="store_true",
        help="play the proposed experiment on the device that runs in the graph, record it into DIR/next, and diagnose "
        "all recordings together into DIR/with_next",
    )
    parser.add_argument("--namespace", default="/vo2", help="of the loop, for --next. Default: /vo2.")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_effects_option(parser)
    options = parser.parse_args(arguments)
    if bool(options.bag) == bool(options.bags):
        parser.error("need --bag BAG, which may be repeated, or --bags FOLDER")
    if options.bags and options.next:
        parser.error("--next plays on one device: give its recordings with --bag")
    try:
        return _run(options)
    except OSError as error:
        place = error.filename or options.output
        return refuse("diagnose", f"{place}: cannot be written ({error.strerror or error})")
    except ValueError as error:
        return refuse("diagnose", error)
    except KeyboardInterrupt:
        print(f"diagnose: interrupted; nothing more is written to {options.output}", file=sys.stderr)
        return 130


def _run(options: argparse.Namespace) -> int:
    output = Path(options.output)
    if options.next:
        _prepare_next(output)
    # after the arguments: a wrong option must not wait for the compiler
    from vo2_models.model_file import load_model_parameters

    if not options.bags:
        _outputs(output).check()
    parameters = load_model_parameters(options.model)
    from vo2_models.diagnosis.nominal import Nominal

    try:
        Nominal.from_parameters(parameters)
    except ValueError as error:
        raise ValueError(f"{options.model}: {error}; fit again") from error
    if options.bags:
        from vo2_identification.batch import diagnose_folder

        return diagnose_folder(options, parameters)
    diagnosis = diagnose_bags(
        options.bag, parameters, output, calibration=options.calibration, quiet=options.quiet
    )
    if not options.next:
        return 0
    return continue_with_next(
        diagnosis.next_experiment,
        options.bag,
        parameters,
        output,
        calibration=options.calibration,
        namespace=options.namespace,
        quiet=options.quiet,
    )


def diagnose_bags(
    bags: Sequence[str | Path],
    parameters: Mapping[str, Value],
    output: Path,
    *,
    calibration: Sequence[str | Path] = (),
    quiet: bool = False,
) -> Diagnosis:
    """Diagnose bags together, write the results into `output`, print the summary, and return the diagnosis.

    Parameters
    ----------
    bags : recordings
    parameters : of the model
    output : folder for the results
    calibration : bags that the model was fitted to, where what is looked for may have been there already
    quiet : no progress

    Raises
    ------
    ValueError, OSError : what cannot be used, in one line.
    """
    from vo2_models.device.model import DeviceModel
    from vo2_models.diagnosis.pipeline import study

    from vo2_identification.bags import read_recording
    from vo2_identification.bags.problems import in_few_lines

    outputs = _outputs(output)
    outputs.check()
    began = time.perf_counter()
    model = DeviceModel.from_parameters(parameters)
    recordings, problems = [], []
    every = [*calibration, *bags]
    for bag in every:
        recording, found = read_recording(bag, device=model.description)
        recordings.append(recording)
        problems += [f"{bag}: {problem}" for problem in in_few_lines(found)]
    with (
        Progress("diagnose", quiet=quiet, every_s=_SAY_S, first_s=_SAY_S) as progress,
        ThreadPoolExecutor(1) as beside,
    ):
        files = beside.submit(import_module, "vo2_models.diagnosis.files")  # what draws takes a while to load
        known = len(calibration)
        result = study(
            recordings[known:],
            parameters,
            calibration=recordings[:known],
            progress=progress,
            names=[str(bag) for bag in every],
        )
        spent = time.perf_counter() - began
        diagnosis: Diagnosis = files.result().write_results(result, output, problems=problems, seconds=spent)
    outputs.remember()
    print(diagnosis.summary)
    print(f"report: {output / 'report.html'}", flush=True)
    return diagnosis


def _outputs(output: Path) -> OutputFolder:
    from vo2_models.diagnosis.result import RESULTS

    return OutputFolder(output, RESULTS)


def _prepare_next(output: Path) -> None:
    """Refuse now what would fail only after the first diagnosis."""
    for name in ("next", "with_next"):
        if (output / name).exists():
            raise ValueError(f"{output / name}: exists already from an earlier --next, need another --output")
    try:
        # before anything else: the ROS wheels start Python anew when they are first imported
        import rclpy  # noqa: F401
    except ImportError as error:
        raise ValueError(f"--next needs ROS 2: {error}") from error


def continue_with_next(
    experiment: NextExperiment | None,
    bags: Sequence[str | Path],
    parameters: Mapping[str, Value],
    output: Path,
    *,
    calibration: Sequence[str | Path] = (),
    namespace: str = "/vo2",
    quiet: bool = False,
) -> int:
    """Play what a diagnosis of `bags` proposes, record it, and diagnose it together with them.

    Parameters
    ----------
    experiment : that the diagnosis proposes; None where nothing is left to separate
    bags : recordings that were diagnosed
    parameters : of the model
    output : folder of the diagnosis; the recording goes into `next` in it, the new results into `with_next`
    calibration : bags that the model was fitted to
    namespace : of the loop with the device
    quiet : no progress

    Returns
    -------
    int : exit status of the command: 0, or 130 if the experiment was interrupted.

    Raises
    ------
    ValueError, OSError : no device to play it on, or a recording that cannot be used.
    """
    if experiment is None:
        print("--next: nothing is left to separate; no experiment is played")
        return 0
    if experiment.excitation is None:
        print(f"--next: no excitation can separate {' and '.join(experiment.separates)}; do this by hand:")
        print(experiment.instruction)
        return 0
    from vo2_identification.bags import read_recording
    from vo2_identification.diagnose.play import play

    names = dict.fromkeys(experiment.separates)
    purpose = f"separates {' and '.join(names)}" if len(names) > 1 else "covers what no recording has yet"
    print(f"--next: playing an experiment that {purpose}", flush=True)
    recording, _ = read_recording(bags[0])
    bag = output / "next"
    with Progress("diagnose", quiet=quiet, every_s=_SAY_S, first_s=_SAY_S) as progress:
        complete = play(
            experiment.excitation,
            bag,
            device=str(parameters["model.device"]),
            sample_period_s=recording.sample_period_s,
            namespace=namespace,
            progress=progress,
        )
    if not complete:
        kept = f"what was recorded is in {bag}" if bag.exists() else "nothing was recorded"
        print(f"diagnose: interrupted; the device is at the safe current, {kept}", file=sys.stderr)
        return 130
    print(f"recorded: {bag}", flush=True)
    diagnose_bags([*bags, bag], parameters, output / "with_next", calibration=calibration, quiet=quiet)
    return 0
