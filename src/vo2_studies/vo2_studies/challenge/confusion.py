"""The confusion matrix: counted, printed, drawn; and the page that shows it with the scores."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo2_studies.challenge.catalogue import CATALOGUE
from vo2_studies.challenge.judging import FAILED, LIMIT, NONE, Judgement

__all__ = ["confusion", "confusion_png", "confusion_text", "page"]

OUTSIDE = "outside catalogue"
SHOWN = (
    ("false_alarm", "false alarms, no effect", 0.02, "most"),
    ("top1", "right name first (mean over effects)", 0.90, "least"),
    ("top3", "right name among first three", 0.97, "least"),
    ("pair_exact", "two effects: both named", 0.70, "least"),
    ("pair_any", "two effects: at least one right", 0.97, "least"),
    ("pair_extra", "two effects: extra wrong name", 0.05, "most"),
    ("outside_unknown", "outside the catalogue: unknown", 0.85, "least"),
    ("outside_excess_removed", "outside: excess removed, median", 0.50, "least"),
    ("excess_removed", "one effect: excess removed, median", 0.80, "least"),
    ("parameter_error", "parameter error, median", 0.15, "most"),
    ("coverage90", "90 % intervals hold the truth", 0.80, "least"),
    ("channel", "right channel", 0.97, "least"),
    ("branch", "right branch", 0.90, "least"),
    ("frequency", "resonance within 5 %", 0.90, "least"),
    ("signal", "right sensor named", None, ""),
    ("told", "named, or told inseparable, not excited", None, ""),
    ("after_experiment_top1", "right after proposed experiment", 0.85, "least"),
    ("seconds", "seconds a diagnosis, median", 20.0, "most"),
)
"""Key of challenge.json, words, the figure to reach, and on which side of it."""


def confusion(judgements: Sequence[Judgement]) -> tuple[list[str], list[str], NDArray[np.int64]]:
    """Return row labels, column labels and counts (rows, columns).

    Rows are the truth of cases with one effect over 10 noise powers, without effect, or outside the catalogue;
    columns what the diagnosis named first. Empty rows and columns are left out.
    """
    ids = [effect.id for effect in CATALOGUE]
    rows = [*ids, NONE, OUTSIDE]
    columns = [*ids, NONE, "unknown", LIMIT, FAILED]
    counts: dict[tuple[str, str], int] = {}
    for judgement in judgements:
        if judgement.kind == "two" or not judgement.counted:
            continue
        row = {"none": NONE, "outside": OUTSIDE}.get(judgement.kind) or judgement.truth[0]
        if judgement.first not in columns:
            columns.append(judgement.first)
        counts[row, judgement.first] = counts.get((row, judgement.first), 0) + 1
    rows = [row for row in rows if any(key[0] == row for key in counts)]
    columns = [column for column in columns if column in rows or any(key[1] == column for key in counts)]
    matrix = np.array([[counts.get((row, column), 0) for column in columns] for row in rows], dtype=np.int64)
    return rows, columns, matrix.reshape(len(rows), len(columns))


def confusion_text(judgements: Sequence[Judgement]) -> str:
    """Return the matrix as lines: a truth, its count, and what was named first, most frequent first."""
    rows, columns, matrix = confusion(judgements)
    lines = [f"{'truth':28s}{'cases':>6s}  named first"]
    for row, counts in zip(rows, matrix, strict=True):
        order = np.argsort(-counts, kind="stable")
        parts = [f"{columns[k]} {counts[k]}" for k in order if counts[k]]
        lines.append(f"{row:28s}{counts.sum():6d}  {', '.join(parts)}")
    return "\n".join(lines)


def confusion_png(judgements: Sequence[Judgement]) -> bytes:
    """Return the matrix as a PNG: rows in shares, counts written into the cells, right answers framed."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    rows, columns, matrix = confusion(judgements)
    figure = Figure(figsize=(3.5 + 0.32 * len(columns), 3.0 + 0.28 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    share = matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1)
    # cividis: reads the same with colour-vision deficiency and in grey
    image = axes.imshow(np.where(matrix > 0, share, np.nan), cmap="cividis_r", vmin=0, vmax=1, aspect="auto")
    for k, row in enumerate(rows):
        for m, column in enumerate(columns):
            if matrix[k, m]:
                colour = "white" if share[k, m] > 0.5 else "black"
                axes.text(m, k, str(matrix[k, m]), ha="center", va="center", fontsize=7, color=colour)
            if column == row or (row == OUTSIDE and column == "unknown"):
                frame = Rectangle((m - 0.5, k - 0.5), 1, 1, fill=False, edgecolor="black", linewidth=1.4)
                axes.add_patch(frame)
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=8)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set_xlabel("named first by the diagnosis")
    axes.set_ylabel("truth, concealed from it")
    axes.set_title("Cases with no or one effect; framed: right", fontsize=10)
    figure.colorbar(image, ax=axes, label="share of the row", shrink=0.6)
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer)
    return buffer.getvalue()


def _number(value: float | None, key: str) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if key == "seconds" else f"{100 * value:.1f} %"


def score_lines(scores: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Return one line a score: words, value, interval with count, figure to reach and whether it is met."""
    lines = []
    for key, words, goal, side in SHOWN:
        value, interval = scores.get(key), scores.get(f"{key}_interval")
        count = scores.get(f"{key}_count")
        spread = f"{100 * interval[0]:.0f}-{100 * interval[1]:.0f} %, n = {count}" if interval else ""
        verdict = ""
        if goal is not None:
            verdict = f"at {side} {_number(goal, key)}"
            if value is not None:
                verdict += ": met" if (value <= goal if side == "most" else value >= goal) else ": missed"
                if interval and interval[0] < goal < interval[1]:
                    verdict += ", but the interval holds both"
        lines.append((words, _number(value, key), spread, verdict))
    return lines


def page(scores: Mapping[str, Any], judgements: Sequence[Judgement], command: str) -> str:
    """Return a self-contained HTML page: scores, confusion figure, effects one by one."""
    picture = base64.b64encode(confusion_png(judgements)).decode("ascii")

    def table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
        cells = "".join(
            "<tr>" + "".join(f"<td>{html.escape(str(cell))}</td>" for cell in line) + "</tr>"
            for line in lines
        )
        return (
            "<table><tr>" + "".join(f"<th>{html.escape(h)}</th>" for h in head) + "</tr>" + cells + "</table>"
        )

    effects = []
    for name, entry in scores["per_effect"].items():
        instead = ", ".join(f"{other} {n}" for other, n in entry["named_instead"].items())
        rates = [_number(entry[key], key) for key in ("top1", "top3")]
        effects.append((name, entry["count"], *rates, instead))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Diagnosis on concealed data</title>'
        "<style>body{font:15px/1.4 sans-serif;max-width:1100px;margin:2em auto;padding:0 1em}"
        "table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #999;padding:3px 8px;text-align:left}"
        "img{max-width:100%}</style></head><body><h1>Diagnosis on concealed data</h1>"
        f"<p>{scores['cases']} cases, drawn and scored by <code>{html.escape(command)}</code>. Intervals are Wilson's, "
        "95 %, over pooled cases. One effect counts from an excess residual of 10 times the noise power.</p>"
        + table(("score", "value", "interval", "to reach"), score_lines(scores))
        + f'<h2>Confusion</h2><img alt="confusion matrix" src="data:image/png;base64,{picture}">'
        + "<h2>Effects</h2>"
        + table(("effect", "cases", "first", "first three", "named instead"), effects)
        + f"<h2>Failures</h2><p>{html.escape(str(scores['failures'] or 'none'))}</p></body></html>\n"
    )
