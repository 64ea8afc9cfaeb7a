"""The simulation that runs beside the device: what the model expects of each sample, and where the device differs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

if TYPE_CHECKING:
    from vo2_models.device.model import DeviceModel

__all__ = ["Expected", "SimulatedBeside"]

_DIFFERS = 5.0
"""Times the residual that the fit left over, noise included, from which a sample counts as another."""
_LEAST = 0.01
"""Share of the response's range below which no sample does: no fit of a quasi-static recording predicts fast ones closer."""
_JITTER = 0.02
_MOST_LOST = 1000
"""Lost samples in a row that are bridged with the drive held; behind a longer gap the memory is unknown."""
_SETTLE_CONSTANTS = 5.0


class Expected(NamedTuple):
    """What the model expects of a sample, and whether the device differs from it.

    Attributes
    ----------
    resistance : [ohm], NaN where it is unknown
    deflection : [m], NaN where it is unknown
    differs : NaN where that is unknown, else 1.0 or 0.0
    """

    resistance: float = math.nan
    deflection: float = math.nan
    differs: float = math.nan


class SimulatedBeside:
    """Steps a fitted model with the measured drive.

    What the device remembers is unknown at first: the model tells nothing until the drive has stood for five time constants
    at the cold end of the operating range or beyond it, where no hysteresis remembers anything.

    Parameters
    ----------
    model : of the device. What is measured of the drive stands where it acted, whatever its recordings say of commands
    """

    def __init__(self, model: DeviceModel) -> None:
        device = model.description
        self._model = model
        self._period = device.sample_period
        self._cold, self._hot = device.operating_range
        self._settle_s = _SETTLE_CONSTANTS * device.time_constant if device.has_body else 0.0
        low, high = device.resistance_range
        ranges = {RESISTANCE: math.log10(high / low), TIP_DEFLECTION: device.deflection_range}
        self._most = {}
        for name in ranges.keys() & model.sensors.keys():
            sensor = model.sensors[name]
            # the resistance's noise is relative, its residuals are in log10 ohm
            noise = sensor.noise / math.log(10.0) if name == RESISTANCE else sensor.noise
            left = max(noise, sensor.residual, sensor.misfit)
            self._most[name] = max(_DIFFERS * left, _LEAST * ranges[name])
        self._stamp_ns = -1
        self._held, self._cold_s, self._known = device.safe, 0.0, False
        self._restart()

    def step(self, stamp_ns: int, current: float, resistance: float, deflection: float) -> Expected:
        """Take a measurement [A, ohm, m] at a stamp [ns]; what is no number is not compared."""
        passed = (stamp_ns - self._stamp_ns) * 1e-9
        first, self._stamp_ns = self._stamp_ns < 0, stamp_ns
        periods = round(passed / self._period)
        if not first and (
            not 1 <= periods <= _MOST_LOST or abs(passed / self._period - periods) > _JITTER * periods
        ):
            if 0.0 < passed < _MOST_LOST * self._period:
                self._period = passed
            self._restart()
            periods = 1
        if not math.isfinite(current):
            self._restart()
            return Expected()
        # held while samples were lost
        for _ in range(0 if first else periods - 1):
            self._stepper.step(self._held)
        row = dict(zip(self._stepper.channels, self._stepper.step(current).tolist(), strict=True))
        self._held = current
        beyond = (current - self._cold) * (self._hot - self._cold) <= 0.0
        self._cold_s = self._cold_s + self._period if beyond else 0.0
        self._known = self._known or self._cold_s > self._settle_s
        if not self._known:
            return Expected()
        expected = {name: row.get(name, math.nan) for name in (RESISTANCE, TIP_DEFLECTION)}
        far = {TIP_DEFLECTION: abs(deflection - expected[TIP_DEFLECTION])}
        if resistance > 0.0 and expected[RESISTANCE] > 0.0:
            far[RESISTANCE] = abs(math.log10(resistance / expected[RESISTANCE]))
        judged = [
            far[name] > most for name, most in self._most.items() if math.isfinite(far.get(name, math.nan))
        ]
        differs = float(any(judged)) if judged else math.nan
        return Expected(expected[RESISTANCE], expected[TIP_DEFLECTION], differs)

    def _restart(self) -> None:
        self._stepper = self._model.stepper(dt=self._period, noise=False)
        self._held, self._cold_s, self._known = self._model.description.safe, 0.0, False
