"""Whether the resistance still comes from the film: a sensor that is stuck, saturated or disconnected.

A stuck or clipped sensor repeats one reading while the current moves. A healthy one may repeat itself too: in a
hold without noise, or where the steps of its converter are coarse. What a repeat proves follows from the noise of
the identified sensor: with a step q and a noise of s.d. s, the next reading equals the last one with a probability
of at most q / (sqrt(2 pi) s), whatever the film does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from vo2_models.device.description import preset
from vo2_models.parameters import Value

__all__ = ["ResistanceCheck", "SensorLimits", "sensor_limits"]

_FALSE_ALARM = 1e-9
"""Chance per sample that a healthy sensor repeats itself so often."""
_FEWEST = 8
_STILL = 1e-9
"""Share of the operating range below which the current has not moved."""
_COARSE_TRAVEL = 0.5
"""Share of the operating range, in temperature, that no step of a usable converter spans."""
_DISCONNECTED = 10.0
"""Factor beyond the preset's resistances that only an open or a shorted lead reaches."""


@dataclass(frozen=True)
class SensorLimits:
    """What is known of a healthy sensor and of its device.

    Attributes
    ----------
    lower_ohm, upper_ohm : at or beyond them the sensor is saturated
    noise : s.d. of what is new in the noise of a sample, relative to the resistance; 0 where it is not known
    cold_a, hot_a : operating range of the current [A]
    linear_gain, square_gain : steady temperature rise per current [K/A] and per squared current [K/A^2]
    time_constant_s : of the temperature [s]
    delay_s : dead time after which a moved current shows in the resistance [s]
    """

    lower_ohm: float
    upper_ohm: float
    noise: float
    cold_a: float
    hot_a: float
    linear_gain: float
    square_gain: float
    time_constant_s: float
    delay_s: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.lower_ohm < self.upper_ohm:
            raise ValueError(
                f"sensor.lower_ohm, sensor.upper_ohm: found {self.lower_ohm:g} and {self.upper_ohm:g} ohm, "
                "need 0 or more, and the lower below the upper"
            )

    def rise(self, current_a: float) -> float:
        """Steady temperature rise at a current [K]."""
        return (self.linear_gain + self.square_gain * current_a) * current_a


def sensor_limits(
    device: str, parameters: Mapping[str, Value], *, lower_ohm: float = 0.0, upper_ohm: float = 0.0
) -> SensorLimits:
    """Return the limits for a preset and flat `model.*` parameters; a bound of 0 is the preset's.

    Parameters
    ----------
    device : preset, or path of a device file
    lower_ohm, upper_ohm : bounds [ohm], 0 for those of the device

    Raises
    ------
    ValueError : bounds in the wrong order.
    """
    nominal = preset(device)
    noise = float(parameters.get("model.sensors.film_resistance.noise", 0.0))  # type: ignore[arg-type]
    colour = np.asarray(parameters.get("model.sensors.film_resistance.colour", []), dtype=np.float64)
    # what the past tells of the next sample is no noise
    fresh = math.sqrt(max(1.0 - float(np.sum(colour**2)), 0.01))
    return SensorLimits(
        lower_ohm or nominal.resistance_range[0] / _DISCONNECTED,
        upper_ohm or nominal.resistance_range[1] * _DISCONNECTED,
        noise * fresh,
        *nominal.operating_range,
        nominal.linear_gain,
        nominal.square_gain,
        nominal.time_constant,
        nominal.dead_time,
    )


class ResistanceCheck:
    """Judges one sample after the other; its memory is the run of equal readings and the steps seen so far."""

    def __init__(self, limits: SensorLimits) -> None:
        self.limits = limits
        self._step: dict[int, float] = {}
        self._last = math.nan
        self._time_s = math.nan
        self._rise = math.nan
        self._still_a = _STILL * abs(limits.hot_a - limits.cold_a)
        self._wide = _COARSE_TRAVEL * abs(limits.rise(limits.hot_a) - limits.rise(limits.cold_a))
        self._begin(math.nan)

    def _begin(self, current_a: float) -> None:
        self._from = current_a
        self._low = self._high = self._rise
        self._moved_s = math.nan
        self._repeats = 0

    def fault(self, time_s: float, resistance_ohm: float, current_a: float) -> str:
        """Return what is wrong with the sensor at this sample, empty if nothing is.

        Parameters
        ----------
        time_s : stamp of the sample [s]
        resistance_ohm : finite and above 0
        current_a : measured heater current [A], NaN where it is not measured: then only saturation is seen
        """
        limits = self.limits
        last, self._last = self._last, resistance_ohm
        self._warm(time_s, current_a)
        if resistance_ohm != last:
            self._begin(current_a)
            # converters with ranges have steps that grow with the reading: one step a decade
            decade = math.floor(math.log10(resistance_ohm))
            step = abs(resistance_ohm - last)
            if step < self._step.get(decade, math.inf):
                self._step[decade] = step
        elif self._repeats or abs(current_a - self._from) > self._still_a:
            if not self._repeats:
                self._moved_s = time_s
            self._repeats += 1
            self._low, self._high = min(self._low, self._rise), max(self._high, self._rise)
        if not limits.lower_ohm < resistance_ohm < limits.upper_ohm:
            return (
                f"the sensor is saturated at {resistance_ohm:.4g} ohm, outside {limits.lower_ohm:.4g} to "
                f"{limits.upper_ohm:.4g} ohm"
            )
        if self._repeats >= _FEWEST and time_s - self._moved_s >= limits.delay_s and self._proves():
            return (
                f"the sensor is stuck or saturated at {resistance_ohm:.6g} ohm for {self._repeats} samples, "
                "while the current moved"
            )
        return ""

    def _proves(self) -> bool:
        """Whether so many repeats, or repeats over so wide a travel, do not come from a healthy sensor."""
        step = self._step.get(math.floor(math.log10(self._last)), math.inf)
        noise = self.limits.noise * self._last
        if step < noise:
            chance = step / (math.sqrt(2.0 * math.pi) * noise)
            return self._repeats * math.log(chance) <= math.log(_FALSE_ALARM)
        return self._high - self._low >= self._wide

    def _warm(self, time_s: float, current_a: float) -> None:
        """Follow the temperature rise: a slow body does not feel a current that only flashes by."""
        steady, passed = self.limits.rise(current_a), time_s - self._time_s
        self._time_s = time_s
        if math.isnan(self._rise) or not passed > 0.0:
            self._rise = steady
        elif not math.isnan(steady):
            self._rise += (steady - self._rise) * -math.expm1(-passed / self.limits.time_constant_s)
