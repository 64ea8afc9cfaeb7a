"""Figures of the entropy-optimal compression of play models."""

from __future__ import annotations

import numpy as np
from vo2_models.hysteresis import partition

from vo2_studies.bench.entry import Entry, Figure
from vo2_studies.bench.timing import alternate

__all__ = ["ENTRIES"]


def _one_peak(n: int, groups: int, repeats: int) -> Figure:
    """Entropy Sum on the one-peak distribution of section 3.5.2, stretched to n plays."""
    j = np.arange(1, n + 1) * 30 / n
    weights = 5 / np.sqrt(2 * np.pi) * np.exp(-((j - 15) ** 2) / 15)
    radii = np.arange(1, n + 1) / (n + 1)
    return Figure(alternate(lambda: partition(radii, weights, groups), repeats=repeats)[0], "s")


ENTRIES = (
    Entry("gpi_compress_30_6", lambda: _one_peak(30, 6, 51), 5e-3),
    Entry("gpi_compress_2000_32", lambda: _one_peak(2000, 32, 5), 1.0),
)
