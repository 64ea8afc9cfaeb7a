"""A documented rule from an identified model to PI and PID gains, with the margins that it leaves.

The rule: the largest integral gain for which the sampled loop keeps both its sensitivity and its complementary
sensitivity below a limit Ms, at the steepest slope of the hysteresis loop and over a spread of the time constant
(M-constrained integral gain optimisation: Astrom, Panagopoulos and Hagglund, Automatica 34, 1998).

Why the integral gain: after every reversal the branch is almost flat until the temperature has crossed the
loop's width. There the loop is open, the error grows, and it is the integrator that drives the temperature across:
the error at reversals falls with Ki and hardly with Kp. A rule that sets Ti to the thermal time constant (lambda
or SIMC tuning) wastes that; it was tried and tracks two to three times worse under reversals. Why the steepest
slope: a loop that is stable there is stable wherever the branch is flatter.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vo2_models.validation import finite_array, positive_number

from vo2_control.controller import Coordinate
from vo2_control.pid import PidGains, pid_law
from vo2_control.sampled_loop import Margins, SampledPlant, ThermalLag, closed_loop_radius, loop_margins

__all__ = ["LocalSlopes", "TunedPid", "local_slopes", "tune_pid"]


@dataclass(frozen=True)
class LocalSlopes:
    """Slopes of deflection over current (or its square) met on a hysteresis loop.

    Attributes
    ----------
    typical, largest : median and 98th percentile of the slopes of the prevailing sign [m/A or m/A^2], by travel of
        the deflection: the flat parts outside the transition count for little
    opposed_share : share of the deflection's travel whose slope has the other sign (thermal expansion)
    """

    typical: float
    largest: float
    opposed_share: float


@dataclass(frozen=True)
class TunedPid:
    """Gains with what they promise: the worst margins over the corners."""

    gains: PidGains
    worst: Margins


def local_slopes(
    current_a: ArrayLike, deflection_m: ArrayLike, *, coordinate: Coordinate = "current", smooth: int = 5
) -> LocalSlopes:
    """Return the slopes along a quasi-static sweep of a fitted model or of a device.

    Parameters
    ----------
    current_a, deflection_m : (n,) a sweep through major and minor loops
    coordinate : abscissa of the slopes, see `vo2_control.controller.Coordinate`
    smooth : steps that one slope spans; raise it for noisy data

    Raises
    ------
    ValueError : fewer than two moving samples; or no prevailing sign (more than 40 % of the deflection's travel opposed),
        which no linear feedback can handle.
    """
    current = finite_array(current_a, "current_a")
    deflection = finite_array(deflection_m, "deflection_m", size=current.size)
    abscissa = current**2 if coordinate == "heating_power" else current
    if current.size <= smooth:
        raise ValueError(f"current_a: found {current.size} samples, need more than smooth = {smooth}")
    travel = abscissa[smooth:] - abscissa[:-smooth]
    # a span that turns round inside is no slope
    moved = np.abs(np.diff(abscissa))
    straight = np.convolve(moved, np.ones(smooth), "valid") <= np.abs(travel) * (1 + 1e-9)
    use = straight & (travel != 0)
    if not np.any(use):
        raise ValueError("current_a: found no stretch that moves one way, need a sweep")
    slope = (deflection[smooth:] - deflection[:-smooth])[use] / travel[use]
    weight = np.abs(slope * travel[use])
    if not np.any(weight > 0):
        raise ValueError("deflection_m: found that it does not move with the current (uncontrollable)")
    sign = 1.0 if np.sum(slope * np.abs(travel[use])) >= 0 else -1.0
    opposed = float(np.sum(weight[slope * sign <= 0]) / np.sum(weight))
    if opposed > 0.4:
        raise ValueError(
            f"deflection_m: found {100 * opposed:.0f} % of the sweep sloping against the rest, need a prevailing "
            "sign; narrow the operating range"
        )
    along = slope * sign > 0
    order = np.argsort(np.abs(slope[along]))
    ranked, share = np.abs(slope[along])[order], np.cumsum(weight[along][order])
    middle, top = (float(ranked[np.searchsorted(share, q * share[-1])]) for q in (0.5, 0.98))
    return LocalSlopes(sign * middle, sign * top, opposed)


def tune_pid(
    plant: ThermalLag,
    sample_period_s: float,
    *,
    derivative: bool = False,
    max_sensitivity: float = 1.6,
    slopes: Sequence[float] = (),
    time_constant_spread: float = 0.2,
    coordinate: Coordinate = "current",
) -> TunedPid:
    """Return the gains with the largest Ki whose sampled loop keeps Ms and Mt below `max_sensitivity`.

    Parameters
    ----------
    plant : lag with the largest local slope as its gain
    sample_period_s : [s]
    derivative : PID instead of PI; pays where the dead time is not small against the lag. The derivative's filter
        has half the loop's delay (dead time and half a sample) as time constant.
    max_sensitivity : customarily 1.4 (cautious) to 2.0 (fast)
    slopes : further local slopes at which the margin must hold, all of the sign of the plant's gain
    time_constant_spread : relative spread of the time constant covered, for instance 0.2 for +-20 %
    coordinate : passed on to the gains

    Raises
    ------
    ValueError : slopes of differing sign, a limit that no gain reaches.
    """
    period = positive_number(sample_period_s, "sample_period_s")
    if not max_sensitivity > 1.05:
        raise ValueError(f"max_sensitivity: found {max_sensitivity:g}, need more than 1.05")
    if any(s * plant.gain <= 0 for s in slopes):
        raise ValueError(f"slopes: found {list(slopes)} with a plant gain of {plant.gain:g}, need one sign")
    corners = [
        replace(plant, gain=slope, time_constant_s=plant.time_constant_s * factor).sampled(period)
        for slope, factor in itertools.product(
            (plant.gain, *slopes), (1 - time_constant_spread, 1.0, 1 + time_constant_spread)
        )
    ]
    delay = plant.dead_time_s + period / 2
    filter_s = delay / 2 if derivative else 0.0
    search = _Search(corners, period, filter_s, max_sensitivity, plant.gain)
    # the loop's natural scales: a crossover near 1 / (3 delay) needs kp = tau / (3 delay K) with tau at most this
    kp_scale = (plant.time_constant_s + delay) / (delay * abs(plant.gain))
    ranges = [np.concatenate([[0.0], np.geomspace(1e-3, 2.0, 40)]) * kp_scale]
    ranges.append(
        np.concatenate([[0.0], np.geomspace(1e-2, 2.0, 14)]) * kp_scale * delay if derivative else np.zeros(1)
    )
    best = (0.0, 0.0, 0.0)
    for _ in range(5):
        for kp, kd in itertools.product(*ranges):
            ki = search.largest_ki(kp, kd, kp_scale / delay)
            if ki > best[0]:
                best = (ki, kp, kd)
        ranges = [_closer(grid, value) for grid, value in zip(ranges, best[1:], strict=True)]
    ki, kp, kd = best
    if ki == 0:
        raise ValueError(
            f"max_sensitivity: found that no gain keeps Ms below {max_sensitivity:g}; allow more, or sample faster"
        )
    sign = math.copysign(1.0, plant.gain)
    gains = PidGains(sign * kp, sign * ki, sign * kd, filter_s if kd else 0.0, coordinate=coordinate)
    law = pid_law(gains, period)
    return TunedPid(gains, max((loop_margins(law, c) for c in corners), key=lambda m: m.sensitivity_peak))


def _closer(grid: NDArray[np.float64], value: float) -> NDArray[np.float64]:
    """Nine points around the best one, between its neighbours in the grid."""
    if grid.size == 1:
        return grid
    k = int(np.argmin(np.abs(grid - value)))
    return np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)], 9)


class _Search:
    """Largest Ki within the limits for given Kp and Kd, on a frequency grid."""

    def __init__(
        self, corners: list[SampledPlant], period: float, filter_s: float, limit: float, gain: float
    ) -> None:
        angle = np.pi * np.geomspace(1e-4, 1, 160)
        z = np.exp(1j * angle)
        # laws are searched for a positive slope
        self._sign = math.copysign(1.0, gain)
        self._corners, self._period, self._filter = corners, period, filter_s
        self._plant = np.array([self._sign * c.response(angle / period) for c in corners])
        self._integral = period * z / (z - 1)
        self._derivative = (z - 1) / ((filter_s + period) * z - filter_s)
        self._limit = limit

    def _within(self, kp: float, kd: float, ki: NDArray[np.float64]) -> NDArray[np.bool_]:
        law = kp + kd * self._derivative + ki[:, None, None] * self._integral
        loop = law * self._plant
        sensitivity = 1 / np.maximum(np.abs(1 + loop), 1e-12)
        peak = np.maximum(sensitivity, np.abs(loop) * sensitivity).max(axis=(1, 2))
        return np.asarray(peak <= self._limit)

    def _stable(self, kp: float, kd: float, ki: float) -> bool:
        gains = PidGains(self._sign * kp, self._sign * ki, self._sign * kd, self._filter)
        law = pid_law(gains, self._period)
        return all(closed_loop_radius(law, corner) < 1 for corner in self._corners)

    def largest_ki(self, kp: float, kd: float, scale: float) -> float:
        """0 where there is none. Upwards from small ones: the first limit met is met before stability is lost."""
        grid = scale * np.geomspace(1e-5, 10.0, 50)
        within = self._within(kp, kd, grid)
        if not within[0] or not self._stable(kp, kd, grid[0]):
            return 0.0
        k = int(np.argmin(within)) if not np.all(within) else grid.size - 1
        low, high = grid[k - 1], grid[k]
        fine = np.linspace(low, high, 40)
        inside = self._within(kp, kd, fine)
        return float(fine[max(int(np.argmin(inside)) - 1, 0)]) if not np.all(inside) else float(high)
