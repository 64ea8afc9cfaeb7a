"""`examples`: all sets of measured data, from their files to predictions of what was held out."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vo2_studies.examples.conditions import Asked
    from vo2_studies.examples.run import Outcome

from vo2_models.command_line import refuse

__all__ = ["main"]

_DESCRIPTION = """
Convert, describe, fit and predict every set of measured data that the project knows, with the device file and the map of
its folder under `examples/`, and compare the error on held-out data with that of a lag and a plain non-negative Preisach
operator of the same data.
"""
_OUTPUTS = ("examples.json", "report.html", "cases")
_ASKED = ("conditions.json", "report.html", "conditions")
_WANTED, _WANTED_MEDIAN = 0.9, 0.7


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(prog="examples", description=_DESCRIPTION, allow_abbrev=False)
    parser.add_argument("--output", type=Path, required=True, help="folder for page, figures and models")
    parser.add_argument("--data", type=Path, help="measured data (default: $VO2_DATA, or ../shared/data)")
    parser.add_argument("--only", metavar="NAME", help="only this example, or only this condition")
    parser.add_argument(
        "--conditions",
        action="store_true",
        help="diagnose what the authors of the data changed, and set it beside an expert's answer (conditions.yaml)",
    )
    options = parser.parse_args(args)
    try:
        return _run(options)
    except (ValueError, OSError) as error:
        return refuse("examples", error)
    except KeyboardInterrupt:
        print("examples: interrupted", file=sys.stderr)
        return 130


def _run(options: argparse.Namespace) -> int:
    from vo2_models.io.output_folder import OutputFolder

    from vo2_studies.examples.cases import read_examples
    from vo2_studies.examples.run import run_case
    from vo2_studies.preisach.measured import data_folder

    data = options.data or data_folder()
    if data is None or not data.is_dir():
        raise ValueError(f"data: found {data or 'none'}, need the folder of measured recordings (--data)")
    if options.conditions:
        return _run_conditions(options, data)
    chosen = [one for one in read_examples(_examples_folder()) if options.only in (None, one.folder.name)]
    if not chosen:
        raise ValueError(f"--only: found {options.only!r}, need the name of a folder of examples")
    outputs = OutputFolder(options.output, _OUTPUTS)
    outcomes = []
    with outputs.replaced() as folder:
        for example in chosen:
            for case in example.cases:
                outcome = run_case(example, case, data, folder / "cases")
                outcomes.append(outcome)
                print(_line(outcome), flush=True)
        (folder / "examples.json").write_text(json.dumps([_row(one) for one in outcomes], indent=1), "utf-8")
        (folder / "report.html").write_text(_page(outcomes), encoding="utf-8")
    print(_verdict(outcomes))
    print(f"report: {options.output / 'report.html'}")
    return 0


def _run_conditions(options: argparse.Namespace, data: Path) -> int:
    from vo2_models.io.output_folder import OutputFolder

    from vo2_studies.examples.cases import read_examples
    from vo2_studies.examples.conditions import ask, read_conditions

    folder = _examples_folder()
    conditions = [c for c in read_conditions(folder / "conditions.yaml") if options.only in (None, c.id)]
    if not conditions:
        raise ValueError(f"--only: found {options.only!r}, need the id of a condition of conditions.yaml")
    examples, found = read_examples(folder), []
    with OutputFolder(options.output, _ASKED).replaced() as output:
        (output / "conditions").mkdir(parents=True)  # there even where no condition could be asked
        for condition in conditions:
            one = ask(condition, examples, data, output / "conditions")
            found.append(one)
            print(f"{condition.id}: {condition.changed}", flush=True)
            print(f"  expert: {condition.expected}\n  tool:   {one.said}\n  {one.agreement}", flush=True)
        rows = [
            {"id": c.id, "expert": c.expected, "tool": one.said, "names": list(one.names), "agreement": one.agreement}
            for one in found
            for c in [one.condition]
        ]  # fmt: skip
        (output / "conditions.json").write_text(json.dumps(rows, indent=1), "utf-8")
        (output / "report.html").write_text(_conditions_page(found), encoding="utf-8")
    print(_counted(found))
    print(f"report: {options.output / 'report.html'}")
    return 0


def _counted(found: Sequence[Asked]) -> str:
    from vo2_studies.examples.conditions import AGREEMENT

    counts = {word: sum(one.agreement == word for one in found) for word in AGREEMENT}
    return f"of {len(found)} conditions: {', '.join(f'{n} {word}' for word, n in counts.items() if n)}"


def _conditions_page(found: Sequence[Asked]) -> str:
    from vo2_models.page.page import page, paragraph, section, table

    rows = [
        [one.condition.id, one.condition.changed, one.condition.expected, one.said, one.agreement]
        for one in found
    ]
    header = ["condition", "what was changed", "expert's answer", "tool's answer", "how they agree"]
    return page(
        "Conditions that were changed",
        "Measured data of other people: what a domain expert would answer, written down before the tool was run, and what "
        "the tool says.",
        [
            section("Answers", table("Side by side", header, rows), paragraph(_counted(found))),
            section("Sources", *(paragraph(f"{o.condition.id}: {o.condition.source}") for o in found)),
        ],
    )


def _examples_folder() -> Path:
    """The folder `examples` of the checkout that this package stands in, or of the present folder."""
    for parent in (Path.cwd(), *Path(__file__).resolve().parents):
        if (parent / "examples").is_dir() and any((parent / "examples").glob("*/example.yaml")):
            return parent / "examples"
    raise ValueError("examples: found no such folder here, need to be started in the checkout of the project")


def _line(one: Outcome) -> str:
    return (
        f"{one.example} {one.case}: {one.channel} held out on {one.samples} samples, {100 * one.error / one.span:.3g} % of "
        f"the span r.m.s.; lag and plain Preisach (L = {one.plain.level}) {100 * one.plain.error / one.span:.3g} %; ratio "
        f"{one.ratio:.2f}; {100 * one.inside:.0f} % within the bounds"
    )


def _verdict(outcomes: Sequence[Outcome]) -> str:
    import numpy as np

    ratios = [one.ratio for one in outcomes]
    met = sum(ratio <= _WANTED for ratio in ratios)
    return (
        f"error over that of lag and plain Preisach: median {np.median(ratios):.2f} (wanted {_WANTED_MEDIAN}), largest "
        f"{max(ratios):.2f}; at most {_WANTED} on {met} of {len(ratios)}"
    )


def _row(one: Outcome) -> dict[str, object]:
    return {
        "example": one.example,
        "case": one.case,
        "channel": one.channel,
        "unit": one.unit,
        "samples": one.samples,
        "span": one.span,
        "error": one.error,
        "within_bounds": one.inside,
        "plain_error": one.plain.error,
        "plain_level": one.plain.level,
        "plain_lag_s": one.plain.lag_s,
        "ratio": one.ratio,
        "lag_s": one.model.scalars["thermal.time_constant"],
        "delay_s": one.model.scalars["driver.dead_time"],
        "notes": list(one.notes),
    }


def _page(outcomes: Sequence[Outcome]) -> str:
    from vo2_models.page.figures import COLOURS, figure_html, new_figure
    from vo2_models.page.page import page, paragraph, section, table

    rows = [
        [
            one.example,
            one.case,
            f"{100 * one.error / one.span:.3g}",
            f"{100 * one.plain.error / one.span:.3g}",
            f"{one.ratio:.2f}",
            f"{100 * one.inside:.0f}",
        ]
        for one in outcomes
    ]
    header = ["set", "case", "error [% of span]", "lag and plain Preisach [%]", "ratio", "within bounds [%]"]
    sections = [
        section(
            "Held-out error",
            table("Root mean square, of the span", header, rows),
            paragraph(_verdict(outcomes)),
        )
    ]
    for one in outcomes:
        device = one.model.description
        (channel,) = one.prediction.channels.values()
        with new_figure(height_in=3.2) as figure:
            course, loop = figure.subplots(1, 2, width_ratios=(2, 1), sharey=True)
            for axes, x in ((course, one.prediction.time_s), (loop, one.prediction.drive)):
                if channel.measured is not None:
                    axes.plot(x, channel.measured, ".", markersize=1, color=COLOURS["true"], label="measured")
                axes.plot(x, channel.value, color=COLOURS["fit"], label="predicted")
            course.set_xlabel("time [s]")
            course.set_ylabel(f"{one.channel} [{device.responses[0].unit}]")
            loop.set_xlabel(f"{device.drive_channel} [{device.drive_unit}]")
            course.legend()
        caption = f"{one.example}, {one.case}: {one.channel} over the time and over the drive"
        sections.append(
            section(
                f"{one.example}: {one.case}", figure_html(figure, caption), *(paragraph(n) for n in one.notes)
            )
        )
    lead = "Measured data of other people, fitted with a device file each, and predicted where the fit was not given them."
    return page("Examples", lead, sections)


if __name__ == "__main__":
    sys.exit(main())
