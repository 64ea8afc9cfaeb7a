"""Our own robust design: H-infinity with integral action, its uncertainty identified from a set of fitted devices.

The weights follow from few choices: the performance weight is an integrator (its pole at 1e-5 rad/s) that asks for
a bandwidth, the effort weight rolls off above it, and the multiplicative weight covers every identified plant.
Among bandwidths and efforts those are taken that keep the sampled loop's Ms and Mt below a limit at every identified
plant, and cost least.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from vo2_control.controller import LinearLaw
from vo2_control.discretise import RobustLaw, robust_law
from vo2_control.generalised_plant import LeadLag, RobustDesign
from vo2_control.hinf import DesignRefused
from vo2_control.sampled_loop import ThermalLag, loop_margins

__all__ = ["covering_weight", "integral_design", "tuned_integral_law"]

_INTEGRATOR_RAD_S = 1e-5


def covering_weight(nominal: ThermalLag, plants: Sequence[ThermalLag]) -> LeadLag:
    """Return W_m with |G_i / G - 1| <= |W_m| for every plant, from 1e-4 to 30 rad/s.

    Of the first-order weights that cover all, the one of least mean logarithm.

    Raises
    ------
    ValueError : no plants, or a plant of the other sign, which no weight below 1 covers.
    """
    if not plants:
        raise ValueError("plants: found none, need at least one identified plant")
    if any(plant.gain * nominal.gain <= 0 for plant in plants):
        raise ValueError("plants: found gains of differing sign, need one sign (sign-flipped plant?)")
    omega = np.logspace(-4, np.log10(30), 200)

    def response(plant: ThermalLag) -> np.ndarray:
        lag = plant.gain / (1j * omega * plant.time_constant_s + 1)
        return lag * np.exp(-1j * omega * plant.dead_time_s)

    error = np.max([np.abs(response(plant) / response(nominal) - 1) for plant in plants], axis=0)
    low = max(float(error[0]), 1e-3) * 1.02
    best: tuple[float, LeadLag] | None = None
    for gain, zero in itertools.product(
        np.geomspace(low, 4 * max(low, float(error.max())), 40), np.geomspace(1e-3, 1e2, 60)
    ):
        weight = LeadLag(float(gain), float(zero), float(100 * zero))
        size = np.abs(weight.response(omega))
        area = float(np.mean(np.log(size)))
        if np.all(size >= error) and (best is None or area < best[0]):
            best = area, weight
    if best is None:
        raise ValueError(
            "plants: found no first-order weight that covers them; identify again or drop outliers"
        )
    return best[1]


def integral_design(
    nominal: ThermalLag, uncertainty: LeadLag, *, bandwidth_rad_s: float, effort: float, noise: float = 0.005
) -> RobustDesign:
    """Return the design: integral performance weight of the given bandwidth [rad/s], effort weight [um/A]."""
    return RobustDesign(
        current_gain_k_per_a=math.copysign(50.0, nominal.gain),
        time_constant_s=nominal.time_constant_s,
        dead_time_s=nominal.dead_time_s,
        slope_m_per_k=abs(nominal.gain) / 50.0,
        uncertainty="multiplicative",
        effort=LeadLag(effort, 1.0, 30.0),
        disturbance=LeadLag(0.02, 2.0, 1.0),
        performance=LeadLag(
            0.5 * bandwidth_rad_s / _INTEGRATOR_RAD_S, 2 * bandwidth_rad_s, _INTEGRATOR_RAD_S
        ),
        plant_noise=LeadLag(noise, 1.0, 100.0),
        sensing_noise=LeadLag(noise, 1.0, 100.0),
        multiplicative=uncertainty,
    )


def tuned_integral_law(
    nominal: ThermalLag,
    plants: Sequence[ThermalLag],
    sample_period_s: float,
    cost: Callable[[LinearLaw], float],
    *,
    max_sensitivity: float = 1.6,
    expected_sign: int = 0,
    progress: Callable[[float], None] | None = None,
) -> RobustLaw:
    """Return the law of least cost whose loop keeps Ms and Mt below the limit at every plant.

    Parameters
    ----------
    nominal : plant of the synthesis
    plants : identified ones, which the uncertainty must cover and the sampled loop must hold
    cost : of a law that keeps the limits

    Raises
    ------
    DesignRefused : no design keeps the limits; says how many were tried and why the last one failed.
    """
    uncertainty = covering_weight(nominal, plants)
    best: tuple[float, RobustLaw] | None = None
    reason = "none was tried"
    grid = list(itertools.product(np.geomspace(0.01, 0.16, 4), np.geomspace(1.0, 10.0, 2)))
    for k, (bandwidth, effort) in enumerate(grid):
        if progress:
            progress(k / len(grid))
        design = integral_design(nominal, uncertainty, bandwidth_rad_s=float(bandwidth), effort=float(effort))
        try:
            # gamma has no meaning of its own here: the margins of the sampled loop decide
            found = robust_law(design, sample_period_s, largest_gamma=math.inf, expected_sign=expected_sign)
        except DesignRefused as refused:
            reason = str(refused)
            continue
        margins = [loop_margins(found.law, plant.sampled(sample_period_s), points=400) for plant in plants]
        peak = max(max(m.sensitivity_peak, m.complementary_peak) for m in margins)
        if not all(m.stable for m in margins) or peak > max_sensitivity:
            reason = f"sensitivity peak {peak:.2f} at an identified plant, need at most {max_sensitivity:g}"
            continue
        value = cost(found.law)
        if best is None or value < best[0]:
            worst = max(margins, key=lambda m: m.sensitivity_peak)
            best = value, replace(found, worst=worst)
    if best is None:
        raise DesignRefused(f"weights: none of {len(grid)} designs keeps the limits; the last: {reason}")
    return best[1]
