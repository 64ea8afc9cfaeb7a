"""From a fitted model to gains: local slopes of its loops, its linear dynamics, then `tune_pid`."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping

import numpy as np
from vo2_models.device.coefficients import Coefficient
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.device.simulation import TRUE_DEFLECTION, Simulation
from vo2_models.parameters import Value

from vo2_control.closed_loop import run_loop
from vo2_control.controller import Coordinate, CurrentLimits, LinearController
from vo2_control.model_plant import linear_plant, quasi_static
from vo2_control.pid import pid_controller
from vo2_control.sampled_loop import ThermalLag, modes
from vo2_control.tuning import LocalSlopes, TunedPid, local_slopes, tune_pid

__all__ = [
    "STILL",
    "held_swing",
    "law_coordinate",
    "loop_slopes",
    "still_moves",
    "thermal_lag",
    "tracking_cost",
    "tuned_from_model",
]

_LEVELS = 161
_SETTLE = 20.0
STILL = 0.02
"""Swing of a held deflection, as a share of the range, up to which a law counts as settled: on models of six devices PI laws
were left with 1.4 % at the most, and PID laws that cycle around the width of the loop had 3 % and more."""
_HELD = (0.3, 0.6, 0.45, 0.75, 0.2, 0.5)
_FEWEST_HELD, _MOST_HELD, _RINGS = 600, 20_000, 12.0
"""Shortest and longest hold in samples, and time constants of a ringing mode that one lasts."""


def law_coordinate(device: str) -> Coordinate:
    """The coordinate in which the preset's steady temperature is linear: heating power for a Joule heater.

    Parameters
    ----------
    device : preset, or path of a device file

    Returns
    -------
    Coordinate : `current` or `heating_power`
    """
    return "heating_power" if preset(device).square_gain else "current"


def loop_slopes(simulation: Simulation) -> LocalSlopes:
    """Return the slopes of deflection over the law's coordinate along a quasi-static major and three minor loops.

    Parameters
    ----------
    simulation : of the fitted model
    """
    nominal = preset(simulation.device)
    coordinate = law_coordinate(simulation.device)
    power = 2 if coordinate == "heating_power" else 1
    cold, hot = (i**power for i in nominal.operating_range)
    middle = 0.5 * (cold + hot)
    turns = [cold, hot, cold, middle, cold, hot, middle, hot, cold]
    path = np.concatenate([np.linspace(a, b, _LEVELS) for a, b in itertools.pairwise(turns)])
    current = path ** (1 / power) if power == 2 else path
    sweep = simulation.simulate(current, dt=_SETTLE * nominal.time_constant, noise=False)
    return local_slopes(current, sweep[TRUE_DEFLECTION], coordinate=coordinate)


def tracking_cost(simulation: Simulation, sample_period_s: float) -> Callable[[LinearController], float]:
    """Return the cost of a controller: root mean square tracking error [m] of the true deflection on the model, without noise.

    For picking the least: the range is added to the error of a law that would be the best yet but does not hold still
    (`held_swing` above `STILL`), so that any that does goes before it.

    The reference crosses the loop in both directions, as the experiments do: two unequal sinusoids around half the
    deflection range, one ten times as fast as the other, and three steps. The fast period is 4 time constants where
    the lag is slow against the sampling, else 56: 100 s and 0.1 s on the two presets.

    Parameters
    ----------
    simulation : of the fitted model
    sample_period_s : [s]
    """
    nominal = preset(simulation.device)
    slow = nominal.time_constant / sample_period_s > 20
    count = round(10 * (4 if slow else 56) * nominal.time_constant / sample_period_s)
    phase = 2 * np.pi * np.arange(count) / count
    span = nominal.deflection_range
    waves = 0.5 + 0.15 * np.sin(phase) - 0.12 * np.sin(10 * phase)
    steps = np.repeat([0.3, 0.6, 0.45], count // 8)
    reference = nominal.deflection_extent[0] + span * np.concatenate([waves, steps])
    start = count // 10
    swing = held_swing(simulation, sample_period_s)
    least = math.inf

    def cost(controller: LinearController) -> float:
        nonlocal least
        error = run_loop(simulation, None, controller, reference, dt=sample_period_s, noise=False).error_m[
            start:
        ]
        found = float(np.sqrt(np.mean(error**2)))
        if found < least:
            if swing(controller) > STILL:
                return found + span
            least = found
        return found

    return cost


def held_swing(simulation: Simulation, sample_period_s: float) -> Callable[[LinearController], float]:
    """Return what a controller leaves of motion on the model, without noise: travel at the end of long holds over the range [1].

    A slow lag and an integrator may cycle for ever around the width of the loop, and a mode may ring; a reference that moves
    all the time hides both.

    Parameters
    ----------
    simulation : of the fitted model
    sample_period_s : [s]
    """
    nominal = preset(simulation.device)
    tau, dead = (simulation.coefficients[k] for k in (Coefficient.TIME_CONSTANT, Coefficient.DEAD_TIME))
    hold = max(_SETTLE * (tau + dead) / sample_period_s, _FEWEST_HELD)
    if sampled := linear_plant(simulation, sample_period_s):
        decay = -np.log(np.abs(modes(sampled(ThermalLag(1.0, tau, dead)))))
        hold = max([hold, *(_RINGS / decay[decay > 0])])
    count = int(min(hold, _MOST_HELD))
    low, span = nominal.deflection_extent[0], nominal.deflection_range
    reference = low + span * np.repeat(_HELD, count)

    def swing(controller: LinearController) -> float:
        run = run_loop(simulation, None, controller, reference, dt=sample_period_s, noise=False)
        ends = run.deflection_m.reshape(len(_HELD), count)[:, -(count // 4) :]
        return float(np.ptp(ends, axis=1).max() / span)

    return swing


def still_moves(swing: float) -> str:
    """Return in words why a law is refused.

    Parameters
    ----------
    swing : of `held_swing` [1]
    """
    return (
        f"a held deflection that swings by {100 * swing:.1f} % of the range in the model's own simulation, need at most "
        f"{100 * STILL:g} %"
    )


def thermal_lag(model: DeviceModel) -> ThermalLag:
    """Return gain, lag and dead time at the steepest slope of the model's loops; `model_plant` knows its further dynamics.

    Raises
    ------
    ValueError : a model without deflection; no prevailing slope; a slope whose sign is not that of the preset.
    """
    if not model.deflection.present:
        raise ValueError("model.deflection: found no law, need one to tune; fit a recording with deflection")
    steepest = loop_slopes(quasi_static(model.simulation)).largest
    nominal = preset(model.device)
    expected = nominal.square_gain or nominal.linear_gain
    if steepest * expected < 0:
        raise ValueError(
            f"model: found a slope of deflection over current of {steepest:.3g}, need the sign "
            f"{'+' if expected > 0 else '-'} of {model.device}: sign-flipped plant; check wiring and recording"
        )
    return ThermalLag(steepest, model.scalars["thermal.time_constant"], model.scalars["driver.dead_time"])


def tuned_from_model(
    parameters: Mapping[str, Value],
    sample_period_s: float,
    *,
    derivative: bool = False,
    max_sensitivity: float = 1.6,
    limits: CurrentLimits | None = None,
) -> TunedPid:
    """Return PI (or PID) gains for the model in flat `model.*` parameters: least `tracking_cost` within the margins.

    Takes about 2 s for a PI and 5 s for a PID. `limits` : of the current, None for the preset's.

    Parameters
    ----------
    sample_period_s : [s]
    derivative : whether to tune a derivative part too
    max_sensitivity : limit of Ms and Mt on all slopes of the loops

    Raises
    ------
    ValueError : no model, a model without deflection, a sign-flipped plant, limits that no gain reaches; or on the model even
        the best gains do not hold still.
    """
    model = DeviceModel.from_parameters(parameters)
    lag = thermal_lag(model)
    bounds = limits or CurrentLimits(*preset(model.device).current_range)
    cost = tracking_cost(model.simulation, sample_period_s)
    tuned = tune_pid(
        lag,
        sample_period_s,
        derivative=derivative,
        max_sensitivity=max_sensitivity,
        cost=lambda gains: cost(pid_controller(gains, bounds, sample_period_s)),
        coordinate=law_coordinate(model.device),
        sampled=linear_plant(model.simulation, sample_period_s),
    )
    swing = held_swing(model.simulation, sample_period_s)(
        pid_controller(tuned.gains, bounds, sample_period_s)
    )
    if swing > STILL:
        raise ValueError(
            f"model: found for the best gains {still_moves(swing)}: sample faster, or set pid.kp and pid.ki by hand"
        )
    return tuned
