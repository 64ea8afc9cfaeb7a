"""Our own robust design: H-infinity with integral action, its uncertainty identified from a set of fitted devices.

The weights follow from few choices: the performance weight is an integrator (its pole at 1e-5 rad/s) that asks for
a bandwidth, the effort weight rolls off above it, and the multiplicative weight covers every identified plant.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from vo2_control.generalised_plant import LeadLag, RobustDesign
from vo2_control.sampled_loop import ThermalLag

__all__ = [
    "central_plant",
    "covering_weight",
    "integral_design",
]

_INTEGRATOR_RAD_S = 1e-5
_COVERED_RAD_S = (1e-4, 3.0)


def _response(plant: ThermalLag, omega: np.ndarray) -> np.ndarray:
    lag = plant.gain / (1j * omega * plant.time_constant_s + 1)
    return np.asarray(lag * np.exp(-1j * omega * plant.dead_time_s))


def central_plant(plants: Sequence[ThermalLag]) -> ThermalLag:
    """Return the lag from which the identified plants deviate least: least mean logarithm of max |G_i / G - 1|.

    The mean of gains and time constants is not it: steep plants with a short lag rise highest above it at high frequency,
    and what a design must hold against is that ratio.

    Raises
    ------
    ValueError : no plants.

    Examples
    --------
    >>> ends = [ThermalLag(-1.0, 20.0), ThermalLag(-3.0, 20.0)]
    >>> round(central_plant(ends).gain, 2)
    -2.0
    """
    if not plants:
        raise ValueError("plants: found none, need at least one identified plant")
    omega = np.geomspace(*_COVERED_RAD_S, 60)
    responses = np.array([_response(plant, omega) for plant in plants])
    sign = math.copysign(1.0, plants[0].gain)
    dead = float(np.mean([plant.dead_time_s for plant in plants]))

    def plant_of(x: np.ndarray) -> ThermalLag:
        return ThermalLag(sign * math.exp(x[0]), math.exp(x[1]), dead)

    def radius(x: np.ndarray) -> float:
        return float(
            np.mean(np.log(np.abs(responses / _response(plant_of(x), omega) - 1).max(axis=0) + 1e-9))
        )

    start = np.mean([[math.log(abs(p.gain)), math.log(p.time_constant_s)] for p in plants], axis=0)
    return plant_of(minimize(radius, start, method="Nelder-Mead").x)


def covering_weight(nominal: ThermalLag, plants: Sequence[ThermalLag]) -> LeadLag:
    """Return W_m with |G_i / G - 1| <= |W_m| for every plant, from 1e-4 to 30 rad/s.

    Of the first-order weights that cover all, the one of least mean logarithm.

    Parameters
    ----------
    plants : to cover
    nominal : G

    Raises
    ------
    ValueError : no plants, or a plant of the other sign, which no weight below 1 covers.
    """
    if not plants:
        raise ValueError("plants: found none, need at least one identified plant")
    if any(plant.gain * nominal.gain <= 0 for plant in plants):
        raise ValueError("plants: found gains of differing sign, need one sign (sign-flipped plant?)")
    omega = np.logspace(-4, np.log10(30), 200)
    error = np.max([np.abs(_response(p, omega) / _response(nominal, omega) - 1) for p in plants], axis=0)
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
    """Return the design: integral performance weight of the given bandwidth [rad/s], effort weight [um/A].

    Parameters
    ----------
    nominal : plant of the design
    uncertainty : weight W_m
    bandwidth_rad_s : [rad/s]
    noise : weight of the measurement noise
    """
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
