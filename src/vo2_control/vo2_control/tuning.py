"""A documented rule from an identified model to PI and PID gains, with the margins that it leaves.

The rule is Skogestad's SIMC (J. Process Control 13, 2003) for a lag with dead time,

    Kp = tau / (K (lambda + theta)),   Ti = min(tau, 4 (lambda + theta)),   Td = theta / 2 for the PID,

with theta the dead time plus half a sample for the hold. K is the *largest* local slope of the hysteresis
loop, because a loop that is stable there is stable wherever the branch is flatter. lambda, the closed loop's
time constant, is the smallest for which the sampled loop keeps its largest sensitivity Ms below a limit at
every corner of slope and time constant: so speed is chosen by robustness and nothing is left to taste but Ms.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from vo2_models.validation import finite_array, positive_number

from vo2_control.controller import Coordinate
from vo2_control.pid import PidGains, pid_law
from vo2_control.sampled_loop import Margins, ThermalLag, loop_margins

__all__ = ["LocalSlopes", "TunedPid", "local_slopes", "tune_pid"]


@dataclass(frozen=True)
class LocalSlopes:
    """Slopes of deflection over current (or its square) met on a hysteresis loop.

    Attributes
    ----------
    typical, largest : median and 98th percentile of the slopes of the prevailing sign [m/A or m/A^2]
    opposed_share : share of the loop, by travel of the input, whose slope has the other sign
    """

    typical: float
    largest: float
    opposed_share: float


@dataclass(frozen=True)
class TunedPid:
    """Gains with what they promise: the closed loop's time constant [s] and the worst margins over the corners."""

    gains: PidGains
    closed_loop_time_constant_s: float
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
    ValueError : fewer than two moving samples; or no prevailing sign (more than 40 % of the travel opposed),
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
    weight = np.abs(travel[use])
    sign = 1.0 if np.sum(slope * weight) >= 0 else -1.0
    opposed = float(np.sum(weight[slope * sign <= 0]) / np.sum(weight))
    if opposed > 0.4:
        raise ValueError(
            f"deflection_m: found {100 * opposed:.0f} % of the sweep sloping against the rest, need a prevailing "
            "sign; narrow the operating range"
        )
    along = np.abs(slope[slope * sign > 0])
    return LocalSlopes(sign * float(np.median(along)), sign * float(np.quantile(along, 0.98)), opposed)


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
    """Return the fastest gains of the rule whose sampled loop keeps Ms below `max_sensitivity`.

    Parameters
    ----------
    plant : lag with the largest local slope as its gain
    sample_period_s : [s]
    derivative : PID instead of PI; pays where the dead time is not small against the lag
    max_sensitivity : Ms, customarily 1.4 (cautious) to 2.0 (fast)
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

    def worst(gains: PidGains) -> Margins:
        law = pid_law(gains, period)
        return max(
            (loop_margins(law, corner, points=400) for corner in corners), key=lambda m: m.sensitivity_peak
        )

    low, high = math.log(period / 20), math.log(200 * (plant.time_constant_s + plant.dead_time_s))
    if worst(_simc(plant, period, math.exp(high), derivative, coordinate)).sensitivity_peak > max_sensitivity:
        raise ValueError(
            f"max_sensitivity: found that no gain of the rule reaches {max_sensitivity:g}; allow more, or sample faster"
        )
    for _ in range(40):
        middle = 0.5 * (low + high)
        peak = worst(_simc(plant, period, math.exp(middle), derivative, coordinate)).sensitivity_peak
        low, high = (low, middle) if peak <= max_sensitivity else (middle, high)
    gains = _simc(plant, period, math.exp(high), derivative, coordinate)
    return TunedPid(gains, math.exp(high), worst(gains))


def _simc(plant: ThermalLag, period: float, lam: float, derivative: bool, coordinate: Coordinate) -> PidGains:
    """The rule for one lambda; the ideal PID of the series form (1 + Td s)(1 + 1/(Ti s))."""
    delay = plant.dead_time_s + period / 2
    kp = plant.time_constant_s / (plant.gain * (lam + delay))
    ti = min(plant.time_constant_s, 4 * (lam + delay))
    if not derivative:
        return PidGains(kp, kp / ti, coordinate=coordinate)
    td = delay / 2
    stretch = 1 + td / ti
    return PidGains(
        kp * stretch,
        kp / ti,
        kp * td,
        derivative_filter_s=max(0.1 * td, period / 4),
        coordinate=coordinate,
    )
