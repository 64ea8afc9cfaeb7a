"""From a fitted model to an H-infinity law with integral action, for either preset and any device with a lag.

The plants that the design must hold are those of the model's loops: half the typical and the largest local slope, each with
its time constant a fifth up and down. They are scaled to one and the same time constant and span of the input before the design
(`REFERENCE_S`, `REFERENCE_SPAN`: those of chapter 8, for which the grid of weights was made) and the law is scaled back.
A sampled command acts half a period late; the design sees that as dead time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.parameters import Value
from vo2_models.validation import positive_number

from vo2_control.controller import CurrentLimits
from vo2_control.discretise import RobustLaw, robust_law
from vo2_control.generalised_plant import METRE_PER_DESIGN_UNIT
from vo2_control.hinf import DesignRefused
from vo2_control.integral_design import central_plant, covering_weight, integral_design
from vo2_control.model_tuning import law_coordinate, loop_slopes, thermal_lag, tracking_cost
from vo2_control.sampled_loop import ThermalLag, loop_margins

__all__ = ["robust_from_model"]

REFERENCE_S, REFERENCE_SPAN = 25.0, 1.2
"""Time constant [s] and span of the current [A] of chapter 8."""
TIME_CONSTANT_SPREAD = 0.2
SLOWEST_PERIOD_S = 0.942
"""Sample period in the scaled time, at most: 0.3 of the Nyquist frequency is where the effort weight rises, 1 rad/s. A lag
that is short against the samples is scaled to less than `REFERENCE_S`."""
FINE, COARSE = (0.1, (0.1, 0.07, 0.05, 0.035, 0.025)), (30.0, (0.2, 0.18, 0.15, 0.13, 0.11, 0.1, 0.08, 0.06))
"""Effort weight and bandwidths [rad/s] tried, where the lag is long against the samples and where it is not. Wider bands keep
the margins of the fine one, too, and hunt across the width of the loop (2.9 um at 0.2 rad/s against 1.3 um at 0.1 on a
device `peltier`)."""
ENOUGH = 2
"""Laws within the limit that are compared: a synthesis takes a second."""
_LEAST_STATIC_GAIN = 100.0
"""Loop gain at zero frequency on the flattest plant: a lasting error of 1 % at most. The synthesis loses the integrator
now and then, next to where it keeps it (gamma 508 beside 3.3): hence several bandwidths."""
_LEAST_LAG = 0.1
"""Lag and dead time over the sample period, below which there is nothing dynamic to design for."""


def robust_from_model(
    parameters: Mapping[str, Value],
    sample_period_s: float,
    *,
    max_sensitivity: float = 1.6,
    limits: CurrentLimits | None = None,
) -> RobustLaw:
    """Return the law of least `tracking_cost` of those whose sampled loop keeps Ms and Mt at every plant of the model.

    Parameters
    ----------
    parameters : flat `model.*`, as `fit` writes them
    sample_period_s : [s]
    max_sensitivity : limit of Ms and Mt
    limits : of the current, None for the preset's

    Returns
    -------
    RobustLaw : `law` in the device's units and the coordinate of `law_coordinate`; synthesis and reductions scaled

    Raises
    ------
    ValueError : no model, a model without deflection, without a heated body or without dynamics, a sign-flipped
        plant.
    DesignRefused : no weights keep the limit.
    """
    period = positive_number(sample_period_s, "sample_period_s")
    model = DeviceModel.from_parameters(parameters)
    nominal = preset(model.device)
    lag = thermal_lag(model)
    if not nominal.has_body:
        raise ValueError(
            f"device {nominal.id}: found no heated body, need one for kind hinf: choose kind pi, or set hinf.*"
        )
    if lag.time_constant_s + lag.dead_time_s < _LEAST_LAG * period:
        raise ValueError(
            f"model.thermal.time_constant: found {lag.time_constant_s:g} s at a sample period of {period:g} s, a model without "
            "dynamics; kind hinf needs a lag to design for: choose kind pi, or set hinf.*"
        )
    coordinate = law_coordinate(model.device)
    power = 2 if coordinate == "heating_power" else 1
    cold, hot = nominal.operating_range
    unit = abs(hot**power - cold**power) / REFERENCE_SPAN
    faster = min(REFERENCE_S / lag.time_constant_s, SLOWEST_PERIOD_S / period)
    weights = FINE if faster * lag.time_constant_s > 0.999 * REFERENCE_S else COARSE
    slopes = loop_slopes(model.simulation)
    plants = [
        ThermalLag(gain * unit, lag.time_constant_s * faster * (1 + spread), lag.dead_time_s * faster)
        for gain in (0.5 * slopes.typical, slopes.largest)
        for spread in (-TIME_CONSTANT_SPREAD, TIME_CONSTANT_SPREAD)
    ]
    cost = tracking_cost(model.simulation, period)
    laws = []
    for robust in _within(plants, period * faster, max_sensitivity, *weights):
        law = robust.law
        law = replace(
            law, c=unit * law.c, d=unit * law.d, conditioning=law.conditioning / unit, sample_period_s=period,
            coordinate=coordinate,
        )  # fmt: skip
        laws.append(replace(robust, law=law))
    bounds = limits or CurrentLimits(*nominal.current_range)
    return min(laws, key=lambda robust: cost(robust.controller(bounds)))


def _within(
    plants: list[ThermalLag], period: float, limit: float, effort: float, bandwidths: Sequence[float]
) -> list[RobustLaw]:
    """The laws within the limit at all plants, with their margins where they are worst."""
    centre = central_plant(plants)
    uncertainty = covering_weight(centre, plants)
    late = replace(centre, dead_time_s=centre.dead_time_s + period / 2)
    static = min(abs(plant.gain) for plant in plants) / METRE_PER_DESIGN_UNIT
    found, reason = [], ""
    for bandwidth in bandwidths:
        design = integral_design(late, uncertainty, bandwidth_rad_s=bandwidth, effort=effort)
        try:
            robust = robust_law(design, period, largest_gamma=math.inf)
        except DesignRefused as refused:
            reason = str(refused)
            continue
        if static * abs(float(np.real(robust.taken.controller(0)))) < _LEAST_STATIC_GAIN:
            reason = "the synthesis found no integral action at these weights"
            continue
        margins = [loop_margins(robust.law, plant.sampled(period), points=400) for plant in plants]
        worst = max(margins, key=lambda m: max(m.sensitivity_peak, m.complementary_peak))
        peak = max(worst.sensitivity_peak, worst.complementary_peak)
        reason = f"Ms or Mt of {peak:.2f}, need at most {limit:g}"
        if peak <= limit:
            found.append(replace(robust, worst=worst))
        if len(found) == ENOUGH:
            break
    if not found:
        raise DesignRefused(f"weights: found none that hold all plants of the model; the last: {reason}")
    return found
