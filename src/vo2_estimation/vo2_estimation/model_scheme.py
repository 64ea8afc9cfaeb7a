"""Open-loop prediction by a whole device model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress

from vo2_models.device import DeviceModel
from vo2_models.device.stepper import Stepper
from vo2_models.parameters import Value
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION

__all__ = ["ModelScheme"]

_SAME, _FINEST = 0.02, 20
"""Relative difference up to which samples count as coming at the device's own period, and into how many steps that is split at
most where they come faster."""
_MOST_STEPS = 10_000
"""Steps of one sample: after a longer gap the device is as good as at rest."""


class ModelScheme:
    """Prediction of deflection and resistance by a whole device model that `fit` wrote, from the drive that flowed.

    Its laws are over a coordinate of the model's own: run on the drive itself they would be another device. It is stepped for as
    long as passes between the samples, at whatever rate they come.

    Raises
    ------
    ValueError : the parameters are no model of a device.
    """

    input_channel = HEATER_CURRENT
    need = "a finite number"
    channels: tuple[str, ...] = (TIP_DEFLECTION, RESISTANCE)
    note = "without feedback from a sensor, so that what the model misses is not corrected"
    known = True
    period_s = 0.0

    def __init__(self, parameters: Mapping[str, Value]) -> None:
        self._simulation = DeviceModel.from_parameters(parameters).simulation
        self.restart()

    def restart(self) -> None:
        """Forget: the next sample comes from a cold device."""
        self._stepper = Stepper(self._simulation, noise=False)
        self._first: float | None = None
        self._paced = False
        self._owed_s = 0.0

    def pass_time(self, step_s: float) -> None:
        """Take note of the time since the last sample that was used [s]; the first one decides into which steps it is split."""
        self._owed_s += step_s
        own = self._stepper.period
        if self._paced or abs(step_s - own) <= _SAME * own:
            self._paced = True
            return
        self._paced = True
        step = max(step_s / max(round(step_s / own), 1), own / _FINEST)
        # a delay may not fit its line in finer steps: then those of the device stay
        with suppress(ValueError):
            self._stepper = Stepper(self._simulation, dt=step, noise=False)
            if self._first is not None:
                self._stepper.step(self._first)

    def bridge(self) -> None:
        """Samples before the next one were lost: it has no bound that could say so."""

    def usable(self, value: float) -> bool:
        """Whether the drive can be used."""
        return math.isfinite(value)

    def step(self, value: float) -> tuple[float, float]:
        """Return (deflection [m], resistance [ohm]) after the time passed at the drive, NaN of what the model has not."""
        count = round(self._owed_s / self._stepper.period)
        self._owed_s -= count * self._stepper.period
        if self._first is None:
            self._first, count = value, max(count, 1)
        for _ in range(min(count, _MOST_STEPS)):
            self._stepper.step(value)
        return (
            self._stepper.true_deflection if self._simulation.has_deflection else math.nan,
            self._stepper.true_resistance if self._simulation.has_resistance else math.nan,
        )
