"""The VO2 film and cantilever on a Peltier stage, held at each temperature until settled: sections 3.6, 6.3 and 6.4."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from vo2_models.device import truth
from vo2_models.device.description import preset
from vo2_models.hysteresis.fitting_gpi import PlayFit, fit_play_model
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

from vo2_studies.preisach.beam import curvature_from_deflection

__all__ = ["COLD", "HOT", "SETTLE_S", "cantilever", "excitation", "film", "fitted_resistance"]

Floats = NDArray[np.float64]

COLD, HOT = 30.0, 84.0
"""Temperatures of the experiments [degC]; the published 90 degC is beyond the preset's current."""
SETTLE_S = 300.0


def excitation(walls: int = 46) -> Floats:
    """Damped oscillation between `COLD` and `HOT` that stops at each wall [degC]."""
    return damped_oscillation(np.linspace(COLD, HOT, walls))


def _settled(seed: int, channel: str) -> Callable[[Floats, int], Floats]:
    nominal, device = preset("peltier"), truth("peltier", seed=seed)

    def measure(temperature: Floats, run: int) -> Floats:
        current = (np.asarray(temperature) - nominal.ambient) / nominal.linear_gain
        return device.simulate(current, dt=SETTLE_S, seed=run)[channel]

    return measure


def film(seed: int) -> Callable[[Floats, int], Floats]:
    """Return measure(temperatures (n,) [degC], run) -> -log10(R/ohm) (n,) with noise, each run from a long rest."""
    resistance = _settled(seed, RESISTANCE)
    return lambda temperature, run: -np.log10(resistance(temperature, run))


def cantilever(seed: int) -> Callable[[Floats, int], Floats]:
    """Return measure(temperatures (n,) [degC], run) -> curvature (n,) [1/m] with noise."""
    deflection, length = _settled(seed, TIP_DEFLECTION), preset("peltier").length
    return lambda temperature, run: curvature_from_deflection(deflection(temperature, run), length)


def fitted_resistance(
    temperature: Floats, output: Floats, plays: int, *, first: int, memoryless: str
) -> PlayFit:
    """Fit -log10 R with the radii j / N from j = `first` on, as sections 3.6 (1) and 6.3 (0) have them."""
    radii = (first + np.arange(plays)) / plays
    return fit_play_model(
        temperature, output, radii=radii, memoryless=memoryless, initial="lower", input_range=(COLD, HOT)
    )
