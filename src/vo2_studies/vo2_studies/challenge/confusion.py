"""The confusion matrix: counted, printed, drawn; and the page that shows it with the scores."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from vo2_models.page.figures import figure_html, new_figure

from vo2_studies.challenge.catalogue import IDS
from vo2_studies.challenge.judging import FAILED, LIMIT, NONE, Judgement

__all__ = ["confusion", "confusion_figure", "confusion_text"]

OUTSIDE = "outside catalogue"


def confusion(judgements: Sequence[Judgement]) -> tuple[list[str], list[str], NDArray[np.int64]]:
    """Return row labels, column labels and counts (rows, columns).

    Rows are the truth of cases with one effect over 10 noise powers, without effect, or outside the catalogue;
    columns what the diagnosis named first. Empty rows and columns are left out.
    """
    ids = list(IDS)
    rows = [*ids, NONE, OUTSIDE]
    columns = [*ids, NONE, "unknown", LIMIT, FAILED]
    counts: dict[tuple[str, str], int] = {}
    for judgement in judgements:
        if judgement.kind == "two" or not judgement.counted:
            continue
        row = OUTSIDE if judgement.kind == "outside" else (judgement.truth or (NONE,))[0]
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


def confusion_figure(judgements: Sequence[Judgement]) -> str:
    """Return the matrix as a figure of the page: rows in shares, counts in the cells, right answers framed."""
    rows, columns, matrix = confusion(judgements)
    with new_figure(3.5 + 0.32 * len(columns), 3.0 + 0.28 * len(rows)) as figure:
        axes = figure.add_subplot()
        axes.grid(False)
        share = matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1)
        # cividis: reads the same with colour-vision deficiency and in grey
        image = axes.imshow(
            np.where(matrix > 0, share, np.nan), cmap="cividis_r", vmin=0, vmax=1, aspect="auto"
        )
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
        figure.colorbar(image, ax=axes, label="share of the row", shrink=0.6)
        return figure_html(
            figure, "Confusion matrix: cases with no or one effect, or outside; framed: right."
        )
