"""Figures as SVG text: labelled axes with units, colours that colour-blind readers can tell apart."""

from __future__ import annotations

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
    # a second to load, which `reproduce --list` does not wait for
    from vo2_models.page.figures import figure_svg, new_figure

    with new_figure(7.5, height * rows) as figure:
        axes = figure.subplots(rows, columns, squeeze=False)
        for axis in axes.flat:
            axis.set_prop_cycle(color=COLOURS)
        plot(*axes.flat)
        for axis in axes.flat:
            if axis.get_legend_handles_labels()[1]:
                axis.legend(loc="best")
            for line in axis.get_lines():
                line.set_rasterized(len(line.get_xdata()) > 4000)
        return Figure(caption, figure_svg(figure, caption))
