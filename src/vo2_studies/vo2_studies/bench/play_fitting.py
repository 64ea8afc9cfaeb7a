"""Figures of the identification of play models."""

from __future__ import annotations

import numpy as np
from vo2_models.hysteresis import EGPI, Sine, TanhEnvelopes, fit_play_model

from vo2_studies.bench.entry import Entry, Figure
from vo2_studies.bench.timing import alternate

__all__ = ["ENTRIES"]


def _fit(*, plays: int, per_play: bool) -> Figure:
    """Fit an EGPI with a sine to 2000 samples of damped oscillation with 0.2 % noise."""
    device = EGPI(
        np.arange(6) / 6,
        [27.0, 5.0, 3.0, 13.0, 1.0, 27.0],
        TanhEnvelopes(0.3, -19.5, 0.25, -14.5),
        Sine(20.0, 0.05, 0.3),
        100.0,
    )
    v = 60 + 40 * np.sin(np.linspace(-1.57, 60, 2000)) * np.linspace(1, 0.1, 2000)
    y, _ = device.simulate(v)
    y = y + 2e-3 * np.ptp(y) * np.random.default_rng(0).standard_normal(v.size)
    (seconds,) = alternate(
        lambda: fit_play_model(v, y, plays=plays, memoryless="sine", per_play=per_play), repeats=3
    )
    fit = fit_play_model(v, y, plays=plays, memoryless="sine", per_play=per_play)
    return Figure(seconds, "s", note=f"residual {fit.nrmse:.2%} of range, noise 0.20 %")


ENTRIES = (
    Entry("egpi6_fit_2000", lambda: _fit(plays=6, per_play=False), 2.0),
    Entry("egpi6_fit_2000_per_play", lambda: _fit(plays=6, per_play=True), 2.0),
)
