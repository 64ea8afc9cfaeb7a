"""A documented rule from an identified model to PI and PID gains, with the margins that it leaves.

The rule: among all gains whose sampled loop keeps both its sensitivity and its complementary sensitivity below a
limit Ms, at the steepest slope of the hysteresis loop and over a spread of the time constant, take those with the
least cost. Steepest slope, because a loop that is stable there is stable wherever the branch is flatter.

Without a cost the largest integral gain wins (M-constrained integral gain optimisation: Astrom, Panagopoulos and
Hagglund, Automatica 34, 1998): after every reversal the branch is almost flat until the temperature has crossed
the loop's width, and it is the integrator that drives it across. With a hysteresis model the cost is the tracking
error of a simulation (`vo2_control.model_tuning`), as section 7.4 tuned; it also sees what no linear margin does, a
slow lag and an integrator that cycle for ever around the loop's width.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vo2_models.validation import finite_array, positive_number

from vo2_control.controller import Coordinate
from vo2_control.pid import PidGains, pid_law
from vo2_control.sampled_loop import (
    Margins,
    SampledPlant,
    ThermalLag,
    closed_loop_radius,
    loop_margins,
    with_modes,
)

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
    cost: Callable[[PidGains], float] | None = None,
    coordinate: Coordinate = "current",
    sampled: Callable[[ThermalLag], SampledPlant] | None = None,
) -> TunedPid:
    """Return the gains of least cost whose sampled loop keeps Ms and Mt below `max_sensitivity`.

    Parameters
    ----------
    plant : lag with the largest local slope as its gain
    sample_period_s : [s]
    derivative : PID instead of PI; pays where the dead time is not small against the lag. The derivative's filter
        has a quarter of the loop's delay (dead time and half a sample) as time constant.
    max_sensitivity : customarily 1.4 (cautious) to 2.0 (fast)
    slopes : further local slopes at which the margin must hold, all of the sign of the plant's gain
    time_constant_spread : relative spread of the time constant covered, for instance 0.2 for +-20 %
    cost : of gains that keep the limits, to be minimised; None for the largest Ki
    coordinate : passed on to the gains
    sampled : what a lag is with all that comes after it, see `model_plant.linear_plant`; None for the lag alone

    Raises
    ------
    ValueError : slopes of differing sign, a limit that no gain reaches.
    """
    period = positive_number(sample_period_s, "sample_period_s")
    if not max_sensitivity > 1.05:
        raise ValueError(f"max_sensitivity: found {max_sensitivity:g}, need more than 1.05")
    if any(s * plant.gain <= 0 for s in slopes):
        raise ValueError(f"slopes: found {list(slopes)} with a plant gain of {plant.gain:g}, need one sign")
    lags = [
        replace(plant, gain=slope, time_constant_s=plant.time_constant_s * factor)
        for slope, factor in itertools.product(
            (plant.gain, *slopes), (1 - time_constant_spread, 1.0, 1 + time_constant_spread)
        )
    ]
    corners = [sampled(lag) if sampled else lag.sampled(period) for lag in lags]
    delay = plant.dead_time_s + period / 2
    filter_s = delay / 4 if derivative else 0.0
    search = _Search(corners, period, filter_s, max_sensitivity)
    sign = math.copysign(1.0, plant.gain)
    # a crossover near 1 / delay needs kp = tau / (delay K): the loop's natural scales
    kp_scale = (plant.time_constant_s + delay) / (delay * abs(plant.gain))
    least = math.inf
    best: PidGains | None = None
    grids = [
        # behind a lightly damped mode little is left but the integral
        np.geomspace(3e-5, 1.5, 24) if sampled else np.geomspace(3e-3, 1.5, 14 if cost else 30),
        np.array([0.0, 0.3, 0.8]) if derivative else np.zeros(1),
        np.geomspace(0.02, 1.0, 6) if cost else np.ones(1),
    ]
    chosen = np.zeros(3)
    for _ in range(5):
        for kp_share, lead, ki_share in itertools.product(*grids):
            kp = kp_share * kp_scale
            kd = lead * kp * delay
            ki = ki_share * search.largest_ki(kp, kd, sign, kp_scale / delay)
            if ki == 0:
                continue
            gains = PidGains(sign * kp, sign * ki, sign * kd, filter_s if kd else 0.0, coordinate=coordinate)
            value = cost(gains) if cost else -ki
            if value < least:
                least, best = value, gains
                chosen = np.array([kp_share, lead, ki_share])
        if best is None:
            raise ValueError(
                f"max_sensitivity: found that no gain keeps Ms below {max_sensitivity:g}; allow more, or sample faster"
            )
        grids = [_closer(grid, float(value)) for grid, value in zip(grids, chosen, strict=True)]
    found = cast(PidGains, best)  # the first round raises otherwise
    law = pid_law(found, period)
    return TunedPid(found, max((loop_margins(law, c) for c in corners), key=lambda m: m.sensitivity_peak))


def _closer(grid: NDArray[np.float64], value: float) -> NDArray[np.float64]:
    """Three points around the best one, half as far apart as its neighbours in the grid."""
    if grid.size == 1:
        return grid
    k = int(np.argmin(np.abs(grid - value)))
    return np.linspace(grid[max(k - 1, 0)], grid[min(k + 1, grid.size - 1)], 5)[1:4]


class _Search:
    """Largest Ki within the limit for given Kp and Kd, on a frequency grid."""

    def __init__(self, corners: list[SampledPlant], period: float, filter_s: float, limit: float) -> None:
        angle = with_modes(np.pi * np.geomspace(1e-4, 1, 160), *corners)
        z = np.exp(1j * angle)
        self._corners, self._period, self._filter, self._limit = corners, period, filter_s, limit
        self._plant = np.array([c.response(angle / period) for c in corners])
        self._integral = period * z / (z - 1)
        self._derivative = (z - 1) / ((filter_s + period) * z - filter_s)

    def _within(self, kp: float, kd: float, ki: NDArray[np.float64]) -> NDArray[np.bool_]:
        law = kp + kd * self._derivative + ki[:, None, None] * self._integral
        loop = law * self._plant
        sensitivity = 1 / np.maximum(np.abs(1 + loop), 1e-12)
        return np.asarray(np.maximum(sensitivity, np.abs(loop) * sensitivity).max(axis=(1, 2)) <= self._limit)

    def largest_ki(self, kp: float, kd: float, sign: float, scale: float) -> float:
        """0 where there is none. Upwards from small ones: the limit is met before stability is lost."""
        grid = scale * np.geomspace(1e-5, 10.0, 50)
        within = self._within(sign * kp, sign * kd, sign * grid)
        law = pid_law(PidGains(sign * kp, sign * grid[0], sign * kd, self._filter), self._period)
        if not within[0] or any(closed_loop_radius(law, corner) >= 1 for corner in self._corners):
            return 0.0
        k = int(np.argmin(within)) if not np.all(within) else grid.size - 1
        fine = np.linspace(grid[k - 1], grid[k], 40)
        inside = self._within(sign * kp, sign * kd, sign * fine)
        return float(fine[max(int(np.argmin(inside)) - 1, 0)]) if not np.all(inside) else float(grid[k])
