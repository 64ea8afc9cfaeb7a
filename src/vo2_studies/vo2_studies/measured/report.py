"""The page and the machine-readable answer on measured data."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from vo2_models.io import write_whole
from vo2_models.page.page import page, paragraph, section, table

from vo2_studies.measured.figures import course_figure, error_figure, laws_figure, piezo_figure
from vo2_studies.measured.laws import LAWS
from vo2_studies.measured.preset_diagnosis import PresetDiagnosis
from vo2_studies.measured.sources import Source
from vo2_studies.measured.study import SetStudy
from vo2_studies.measured.where import Line
from vo2_studies.measured.words import (
    across_sets,
    diagnosis_sentence,
    laws_won,
    parameters_text,
    scale_of,
    unit_of,
    verdict,
)

__all__ = ["SetReport", "write_report"]

_ASSUMPTIONS = {
    "pulses": (
        "The drive is the electrical power V I of the two-terminal film, which heats itself. During a pulse the power "
        "contains the resistance, so only what follows the pulses is judged, and the reading at 0.5 V counts as no "
        "power. The stage was at 68.5 °C, inside the transition."
    ),
    "relaxation": (
        "Only the resistance was kept by its authors. Current and length of the pulse are those of the column's "
        "heading; power is I² R with the measured R, and none after the pulse. Where only the length is told, one "
        "unknown current is taken for all."
    ),
    "piezo": (
        "No heater and no film: the drive is the voltage, the hysteresis that of the ceramic, and kelvins mean a share of "
        "3.6 V. Every period of the 1 Hz sinusoid is the same major loop: minor loops and other rates were not excited."
    ),
}


@dataclass(frozen=True)
class SetReport:
    """Everything to be told of a set."""

    source: Source
    study: SetStudy
    diagnosis: PresetDiagnosis | None
    line: Line | None
    problems: tuple[str, ...]
    seconds: float


def write_report(folder: Path, reports: Sequence[SetReport], missing: Sequence[str]) -> tuple[Path, Path]:
    """Write `report.html` and `measured.json` into `folder`; return their paths."""
    parts = [_summary(reports, missing), *(_set_section(report) for report in reports)]
    lead = (
        "Recordings of other people's devices, converted to bags, fitted without and with what may be missing, and judged "
        "on data that no fit saw. Kelvins carry no scale here: no recording has a temperature."
    )
    html = folder / "report.html"
    write_whole(html, page("Diagnosis on measured data", lead, parts))
    answer = folder / "measured.json"
    text = json.dumps(
        {
            "schema": "vo2-measured/1",
            "sets": {report.source.key: _entry(report) for report in reports},
            "across_sets": across_sets([report.study for report in reports]),
            "missing": list(missing),
        },
        indent=1,
        ensure_ascii=False,
    )
    write_whole(answer, text + "\n")
    return html, answer


def _summary(reports: Sequence[SetReport], missing: Sequence[str]) -> str:
    rows = []
    for report in reports:
        study, scale = report.study, scale_of(report.study)
        rows.append(
            [
                report.source.title,
                f"{scale * study.of('rate_independent').held:.3g}",
                f"{scale * study.of('one_lag').held:.3g}",
                f"{study.chosen.candidate.id}: {scale * study.chosen.held:.3g} ({100 * study.chosen.gain:.0f} %)",
                f"{study.best.candidate.id}: {scale * study.best.held:.3g} ({100 * study.best.gain:.0f} %)",
                f"{scale * study.noise:.2g} {unit_of(study)}",
                study.chosen.candidate.id if study.named else "not named",
            ]
        )
    header = [
        "set", "rate independent", "one lag", "best effect of the catalogue", "best of all", "noise", "verdict",
    ]  # fmt: skip
    caption = "Held-out error, r.m.s.; in brackets the share that it removes of the excess of the better of the two simple models"
    sentences = [paragraph(f"{report.source.title}. {verdict(report.study)}") for report in reports]
    sentences += [paragraph(text) for text in across_sets([report.study for report in reports])]
    gone = [paragraph(f"Not there: {', '.join(missing)}.")] if missing else []
    return section("What was found", table(caption, header, rows), *sentences, *gone)


def _set_section(report: SetReport) -> str:
    study = report.study
    single = len(study.cases) == 1
    words = _ASSUMPTIONS.get(report.source.key, _ASSUMPTIONS["relaxation"])
    parts = [
        paragraph(f"Source: {report.source.cited}. {words}"),
        paragraph("Held out in turn: " + "; ".join(fold.words for fold in study.folds) + "."),
        paragraph(verdict(study)),
        piezo_figure(study) if single else course_figure(study),
        error_figure(study),
        _candidates(study),
    ]
    if report.line is not None:
        parts.append(
            paragraph(
                f"A line at {report.line.frequency_hz:.1f} Hz of amplitude "
                f"{scale_of(study) * report.line.amplitude:.2g} {unit_of(study)} stands in {report.line.recordings} "
                "recordings, in the time when nothing else changes: interference, not physics of the device."
            )
        )
    if study.laws:
        parts += [laws_figure(study), _laws(study)]
    if report.diagnosis is not None:
        seen = ", ".join(report.diagnosis.recordings)
        head = "the whole recording" if single else seen
        parts.append(paragraph(f"{diagnosis_sentence(report.diagnosis)} (It saw {head}.)"))
    if report.problems:
        parts.append(paragraph("The data: " + "; ".join(report.problems[:4]) + "."))
    return section(report.source.title, *parts)


def _candidates(study: SetStudy) -> str:
    scale, unit = scale_of(study), unit_of(study)
    rows = [
        [
            judged.candidate.id + ("" if judged.candidate.in_catalogue else " (not in the catalogue)"),
            f"{scale * judged.training:.3g}",
            f"{scale * judged.held:.3g}",
            f"{100 * judged.gain:.0f}",
            f"{len(judged.fits)} of {len(study.folds)}",
            parameters_text(judged),
        ]
        for judged in study.judgements
    ]
    header = [
        "model", f"fitted [{unit}]", f"held out [{unit}]", "gain [%]", "splits", "parameters (one value a split)",
    ]  # fmt: skip
    equations = [
        paragraph(f"{judged.candidate.id}: {judged.candidate.equation}.")
        for judged in {j.candidate.id: j for j in (study.chosen, study.best)}.values()
    ]
    return table(
        f"Errors r.m.s.; gain: share of the excess of {study.reference} removed on held-out data",
        header,
        rows,
    ) + "".join(equations)


def _laws(study: SetStudy) -> str:
    won = laws_won(study)
    rows = [
        [
            law,
            LAWS[law].equation,
            f"{_median([r.between[law] for r in study.laws]):.3g}",
            str(won[law][0]),
            f"{_median([r.later[law] for r in study.laws]):.3g}",
            str(won[law][1]),
        ]
        for law in LAWS
    ]
    header = [
        "law", "log10 (R / Ω) =", "between: median error [log10 Ω]", "best of", "later: median error [log10 Ω]", "best of",
    ]  # fmt: skip
    return table(f"Laws of relaxation on {len(study.laws)} recordings, held out", header, rows)


def _median(values: Sequence[float]) -> float:
    return sorted(values)[len(values) // 2]


def _entry(report: SetReport) -> dict[str, Any]:
    """A set in the machine-readable answer; errors in judged units (log10 ohm, m)."""
    study = report.study
    entry: dict[str, Any] = {
        "title": report.source.title,
        "source": report.source.cited,
        "recordings": [case.label for case in study.cases],
        "held_out": [fold.words for fold in study.folds],
        "unit": "log10 ohm" if scale_of(study) == 1.0 else "m",
        "noise": study.noise,
        "verdict": verdict(study),
        "reference": study.reference,
        "named": study.chosen.candidate.id if study.named else None,
        "why_not": list(study.reasons),
        "rivals": list(study.rivals),
        "candidates": [
            {
                "id": judged.candidate.id,
                "in_catalogue": judged.candidate.in_catalogue,
                "equation": judged.candidate.equation,
                "rms_fitted": judged.training,
                "rms_held_out": judged.held,
                "gain_held_out": judged.gain,
                "splits": [{"values": fit.values, "std": fit.std} for fit in judged.fits],
            }
            for judged in study.judgements
        ],
        "line": None if report.line is None else asdict(report.line),
        "seconds": round(report.seconds, 1),
    }
    if study.laws:
        entry["laws"] = {
            "held_out_between": {law: [r.between[law] for r in study.laws] for law in LAWS},
            "held_out_later": {law: [r.later[law] for r in study.laws] for law in LAWS},
            "best": {law: {"between": n[0], "later": n[1]} for law, n in laws_won(study).items()},
        }
    if report.diagnosis is not None:
        found = report.diagnosis
        entry["diagnosis"] = {
            "recordings": list(found.recordings),
            "refusal": found.refusal or None,
            "summary": found.diagnosis.summary if found.diagnosis else None,
            "verdict": found.diagnosis.verdict if found.diagnosis else None,
            "effects": [e.id for e in found.diagnosis.effects] if found.diagnosis else [],
            "fit": {c: asdict(f) for c, f in found.diagnosis.fit.items()} if found.diagnosis else {},
        }
    return entry
