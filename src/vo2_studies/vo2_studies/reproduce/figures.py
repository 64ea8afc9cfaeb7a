"""Figures as SVG text: labelled axes with units, colours that colour-blind readers can tell apart."""

from __future__ import annotations

import io
from collections.abc import Callable

from vo2_studies.reproduce.claims import Figure

__all__ = ["COLOURS", "STYLES", "draw"]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's palette."""
STYLES = ("-", "--", "-.", ":")


def draw(
    caption: str, plot: Callable[..., None], *, rows: int = 1, columns: int = 1, height: float = 3.0
) -> Figure:
    """Return the figure that `plot(*axes)` draws: `rows` panels above each other, `columns` side by side."""
    import matplotlib
    from cycler import cycler

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with pyplot.rc_context(
        {
            "axes.prop_cycle": cycler(color=list(COLOURS)),
            "axes.grid": True,
            "grid.alpha": 0.3,
            "svg.hashsalt": "vo2",
            "svg.fonttype": "none",
            "font.size": 9,
        }
    ):
        figure, axes = pyplot.subplots(
            rows, columns, figsize=(7.5, height * rows), squeeze=False, layout="constrained"
        )
        plot(*axes.flat)
        for axis in axes.flat:
            if axis.get_legend_handles_labels()[1]:
                axis.legend(loc="best", fontsize=8)
            for line in axis.get_lines():
                line.set_rasterized(len(line.get_xdata()) > 4000)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
        pyplot.close(figure)
    svg = text.getvalue()
    return Figure(caption, svg[svg.index("<svg") :])
