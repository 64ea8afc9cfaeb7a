"""Open-loop prediction by a whole device model."""

from __future__ import annotations

import math
from collections.abc import Mapping

from vo2_models.device import DeviceModel
from vo2_models.device.stepper import Stepper
from vo2_models.parameters import Value
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION

__all__ = ["ModelScheme"]


class ModelScheme:
    """Prediction of deflection and resistance by a whole device model that `fit` wrote, from the drive that flowed.

    Its laws are over a coordinate of the model's own: run on the drive itself they would be another device.

    Raises
    ------
    ValueError : the parameters are no model of a device.
    """

    input_channel = HEATER_CURRENT
    need = "a finite number"
    channels: tuple[str, ...] = (TIP_DEFLECTION, RESISTANCE)
    note = "without feedback from a sensor, so that what the model misses is not corrected"
    known = True

    def __init__(self, parameters: Mapping[str, Value]) -> None:
        self._simulation = DeviceModel.from_parameters(parameters).simulation
        self.restart()
        self.period_s = self._stepper.period

    def restart(self) -> None:
        """Forget: the next sample comes from a cold device."""
        self._stepper = Stepper(self._simulation, noise=False)

    def bridge(self) -> None:
        """Samples before the next one were lost: it has no bound that could say so."""

    def usable(self, value: float) -> bool:
        """Whether the drive can be used."""
        return math.isfinite(value)

    def step(self, value: float) -> tuple[float, float]:
        """Return (deflection [m], resistance [ohm]) after a period at the drive, NaN of what the model has not."""
        self._stepper.step(value)
        return (
            self._stepper.true_deflection if self._simulation.has_deflection else math.nan,
            self._stepper.true_resistance if self._simulation.has_resistance else math.nan,
        )
