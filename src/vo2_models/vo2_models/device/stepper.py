"""A device as a stream: one commanded current in, one sample of every channel out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import chain
from vo2_models.device.coefficients import CHANNELS
from vo2_models.device.description import preset
from vo2_models.device.simulation import Simulation, noise_generators
from vo2_models.validation import positive_number

__all__ = ["Stepper"]

_BLOCK = 4096


class Stepper:
    """Steps a simulation sample by sample, bit-identical to `Simulation.simulate` with the same arguments.

    Attributes
    ----------
    channels : names of the measured channels, in the order in which `step` returns them
    period : sample period [s]
    sample : number of samples made so far; the next one's stamp is sample * period
    """

    def __init__(
        self, simulation: Simulation, *, dt: float | None = None, seed: int = 0, noise: bool = True
    ) -> None:
        nominal = preset(simulation.device)
        self.period = nominal.sample_period if dt is None else positive_number(dt, "dt")
        self.channels = nominal.channels
        self.sample = 0
        self._simulation = simulation
        self._state = simulation.initial_state()
        steps = simulation.steps_per_sample(self.period)
        self._c = simulation.prepared(self.period / steps)
        self._generators = noise_generators(seed) if noise else []
        self._noise = np.zeros((_BLOCK, len(CHANNELS)))
        self._at = _BLOCK
        self._command = np.empty(steps)
        self._normals = np.full((steps, len(CHANNELS)), np.nan)
        self._out = np.empty((steps, chain.COLUMNS))
        self._row = self._out[-1]
        measured = [CHANNELS.index(name) for name in self.channels]
        # a view where the channels stand in one piece: picking by an index array takes a microsecond of every sample
        whole = measured == list(range(measured[0], measured[-1] + 1))
        self._measured = self._row[measured[0] : measured[-1] + 1] if whole else None
        self._places = np.array(measured)

    def step(self, current: float) -> NDArray[np.float64]:
        """Apply the current [A] for one period; return the sample's measured channels (as `channels` orders them).

        Raises
        ------
        ValueError : the current is not finite (the device stays as it is).
        """
        if not math.isfinite(current):
            raise ValueError(f"current: found {current}, need a finite number of ampere")
        if self._at == _BLOCK:
            self._at = 0
            for k, generator in enumerate(self._generators):
                self._noise[:, k] = generator.standard_normal(_BLOCK)
        self._command[:] = current
        self._normals[-1] = self._noise[self._at]
        self._simulation.call(self._c, self._state, self._command, self._normals, self._out)
        self._at += 1
        self.sample += 1
        return self._row[self._places] if self._measured is None else self._measured.copy()

    @property
    def true_deflection(self) -> float:
        """Tip deflection of the last sample before its sensor [m]."""
        return float(self._row[4])

    @property
    def true_resistance(self) -> float:
        """Resistance of the last sample before its sensor [ohm]."""
        return float(self._row[6])

    @property
    def temperature(self) -> float:
        """Film temperature of the last sample [degC]."""
        return float(self._row[5])
