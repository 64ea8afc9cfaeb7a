"""From a fitted model to an H-infinity law with integral action, for either preset and any device with a lag.

The plants that the design must hold are those of the model's loops: half the typical and the largest local slope, each with
its time constant a fifth up and down. They are scaled to one and the same time constant, span of the input and range of the
deflection before the design (`REFERENCE_S`, `REFERENCE_SPAN`, `REFERENCE_M`: those of chapter 8, for which the grid of weights
was made) and the law is scaled back. What else is linear in the model, a mode or a slow sensor, is not designed for: a law
counts whose margins hold with it. A sampled command acts half a period late; the design sees that as dead time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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
from vo2_control.model_plant import linear_plant, quasi_static
from vo2_control.model_tuning import (
    STILL,
    held_swing,
    law_coordinate,
    loop_slopes,
    still_moves,
    thermal_lag,
    tracking_cost,
)
from vo2_control.sampled_loop import ThermalLag, loop_margins

__all__ = ["robust_from_model"]

REFERENCE_S, REFERENCE_SPAN, REFERENCE_M = 25.0, 1.2, preset("peltier").deflection_range
"""Time constant [s], span of the current [A] and range of the deflection [m] of chapter 8."""
TIME_CONSTANT_SPREAD = 0.2
SLOWEST_PERIOD_S = 0.942
"""Sample period in the scaled time, at most: 0.3 of the Nyquist frequency is where the effort weight rises, 1 rad/s. A lag
that is short against the samples is scaled to less than `REFERENCE_S`."""
FINE, COARSE = (0.1, (0.1, 0.07, 0.05, 0.035, 0.025)), (30.0, (0.2, 0.18, 0.15, 0.13, 0.11, 0.1, 0.08, 0.06))
"""Effort weight and bandwidths [rad/s] tried, where the lag is long against the samples and where it is not. Wider bands keep
the margins of the fine one, too, and hunt across the width of the loop: on a fitted `peltier` a held deflection swings by 5 % of
the range at 0.1 rad/s, by 1.8 % at 0.05."""
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
    """Return the law of least `tracking_cost` of those that keep Ms and Mt at every plant of the model and hold it still.

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
    DesignRefused : no weights keep the limit and hold the model still.
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
    span = abs(hot**power - cold**power) / REFERENCE_SPAN
    unit = span * REFERENCE_M / nominal.deflection_range
    faster = min(REFERENCE_S / lag.time_constant_s, SLOWEST_PERIOD_S / period)
    weights = FINE if faster * lag.time_constant_s > 0.999 * REFERENCE_S else COARSE
    slopes = loop_slopes(quasi_static(model.simulation))
    lags = [
        ThermalLag(gain, lag.time_constant_s * (1 + spread), lag.dead_time_s)
        for gain in (0.5 * slopes.typical, slopes.largest)
        for spread in (-TIME_CONSTANT_SPREAD, TIME_CONSTANT_SPREAD)
    ]
    sampled = linear_plant(model.simulation, period)
    own = [sampled(one) if sampled else one.sampled(period) for one in lags]

    swing = held_swing(model.simulation, period)
    bounds = limits or CurrentLimits(*nominal.current_range)

    def judged(robust: RobustLaw) -> tuple[RobustLaw, str]:
        """The law in the device's units, with its margins where they are worst, and what is against it."""
        law = robust.law
        law = replace(
            law, c=unit * law.c, d=unit * law.d, conditioning=law.conditioning / unit, sample_period_s=period,
            coordinate=coordinate,
        )  # fmt: skip
        margins = [loop_margins(law, plant, points=400) for plant in own]
        worst = max(margins, key=lambda m: max(m.sensitivity_peak, m.complementary_peak))
        robust = replace(robust, law=law, worst=worst)
        peak = max(worst.sensitivity_peak, worst.complementary_peak)
        if peak > max_sensitivity:
            return robust, f"Ms or Mt of {peak:.2f}, need at most {max_sensitivity:g}"
        moved = swing(robust.controller(bounds))
        return robust, "" if moved <= STILL else still_moves(moved)

    scaled = [
        ThermalLag(one.gain * unit, one.time_constant_s * faster, one.dead_time_s * faster) for one in lags
    ]
    laws = _within(scaled, period * faster, judged, *weights)
    cost = tracking_cost(model.simulation, period)
    return min(laws, key=lambda robust: cost(robust.controller(bounds)))


def _within(
    plants: list[ThermalLag],
    period: float,
    judged: Callable[[RobustLaw], tuple[RobustLaw, str]],
    effort: float,
    bandwidths: Sequence[float],
) -> list[RobustLaw]:
    """The first laws that nothing is against, as `judged` returns them."""
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
        robust, reason = judged(robust)
        if not reason:
            found.append(robust)
        if len(found) == ENOUGH:
            break
    if not found:
        raise DesignRefused(
            f"weights: found none that hold all plants of the model; the last: {reason}: choose kind pi, or sample faster"
        )
    return found
