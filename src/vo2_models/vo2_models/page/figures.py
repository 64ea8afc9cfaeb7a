"""Matplotlib figures as inline SVG, in colours that colour-blind readers and grey printers can tell apart."""

from __future__ import annotations

import html
import io
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vo2_models.page.page import figure as figure_part

__all__ = ["COLOURS", "drawn", "figure_html", "figure_svg", "new_figure"]

COLOURS = {
    "true": "#000000",
    "reference": "#777777",
    "composite": "#0072B2",
    "polynomial": "#D55E00",
    "fit": "#0072B2",
    "held_out": "#D55E00",
}
"""From the palette of Okabe and Ito."""

_RC: dict[Any, Any] = {
    "font.size": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.fonttype": "path",
    "svg.hashsalt": "vo2",
    "lines.linewidth": 1.0,
    "path.simplify_threshold": 0.5,
}


STRETCHES = 800
"""Stretches of a long course of which smallest and largest values are drawn: more than the columns of pixels of a print."""


def drawn(*columns: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the samples that a line through long columns needs to look as through all: where each is least and largest.

    Parameters
    ----------
    columns : (n,) each; NaN where missing

    Returns
    -------
    array : places in order, all of them of short columns
    """
    count = columns[0].size
    if count <= 2 * len(columns) * STRETCHES:
        return np.arange(count)
    edges = np.arange(STRETCHES + 1) * count // STRETCHES
    kept = set(edges[:-1].tolist())
    for column in columns:
        low, high = (np.where(np.isfinite(column), column, missing) for missing in (np.inf, -np.inf))
        for a, b in itertools.pairwise(edges.tolist()):
            kept |= {a + int(np.argmin(low[a:b])), a + int(np.argmax(high[a:b]))}
    return np.array(sorted(kept), dtype=np.intp)


@contextmanager
def new_figure(width_in: float = 7.2, height_in: float = 3.0) -> Iterator[Figure]:
    """Give a figure to draw on; no window, no global state.

    Parameters
    ----------
    width_in : [inch]
    height_in : [inch]

    Yields
    ------
    Figure : to draw on, closed at the end of the `with`
    """
    with matplotlib.rc_context(_RC):
        yield Figure(figsize=(width_in, height_in), layout="constrained")


def figure_svg(figure: Figure, caption: str) -> str:
    """Return the figure as an SVG element, labelled for screen readers by the caption."""
    stream = io.StringIO()
    with matplotlib.rc_context(_RC):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    svg = stream.getvalue()
    label = html.escape(caption, quote=True)
    return svg[svg.index("<svg") :].replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)


def figure_html(figure: Figure, caption: str) -> str:
    """Return the figure as inline SVG with a caption that also serves screen readers."""
    return figure_part(figure_svg(figure, caption), caption)
