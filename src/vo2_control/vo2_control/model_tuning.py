"""From a fitted model to gains: local slopes of its loops, thermal lag and dead time, then `tune_pid`."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping

import numpy as np
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.device.simulation import TRUE_DEFLECTION, Simulation
from vo2_models.parameters import Value

from vo2_control.closed_loop import run_loop
from vo2_control.controller import Coordinate, CurrentLimits, LinearController
from vo2_control.pid import pid_controller
from vo2_control.sampled_loop import ThermalLag
from vo2_control.tuning import LocalSlopes, TunedPid, local_slopes, tune_pid

__all__ = ["law_coordinate", "loop_slopes", "thermal_lag", "tracking_cost", "tuned_from_model"]

_LEVELS = 161
_SETTLE = 20.0


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

    def cost(controller: LinearController) -> float:
        error = run_loop(simulation, None, controller, reference, dt=sample_period_s, noise=False).error_m[
            start:
        ]
        return float(np.sqrt(np.mean(error**2)))

    return cost


def thermal_lag(model: DeviceModel) -> ThermalLag:
    """Return the plant at the steepest slope of the model's loops.

    Raises
    ------
    ValueError : a model without deflection; no prevailing slope; a slope whose sign is not that of the preset.
    """
    if not model.deflection.present:
        raise ValueError("model.deflection: found no law, need one to tune; fit a recording with deflection")
    steepest = loop_slopes(model.simulation).largest
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
    ValueError : no model, a model without deflection, a sign-flipped plant, limits that no gain reaches.
    """
    model = DeviceModel.from_parameters(parameters)
    lag = thermal_lag(model)
    bounds = limits or CurrentLimits(*preset(model.device).current_range)
    cost = tracking_cost(model.simulation, sample_period_s)
    return tune_pid(
        lag,
        sample_period_s,
        derivative=derivative,
        max_sensitivity=max_sensitivity,
        cost=lambda gains: cost(pid_controller(gains, bounds, sample_period_s)),
        coordinate=law_coordinate(model.device),
    )
