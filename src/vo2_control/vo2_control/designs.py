"""Every control law by name: from parameters to a `Controller`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from vo2_models.parameters import Parameter, Value
from vo2_plant_sim.interface.model import operating_point

from vo2_control.controller import Controller, CurrentLimits
from vo2_control.pid import (
    PID_PARAMETERS,
    PUBLISHED_PELTIER_PID,
    PidGains,
    pid_controller,
    pid_from_parameters,
)

__all__ = ["CONTROLLER_KINDS", "CONTROLLER_PARAMETERS", "design_controller"]

CONTROLLER_KINDS = ("pi", "pid")

CONTROLLER_PARAMETERS = (
    *PID_PARAMETERS,
    Parameter(
        "limits.lower_a", 0.0, "A", "Smallest current; equal to upper_a for the operating range.", -10.0, 10.0
    ),
    Parameter("limits.upper_a", 0.0, "A", "Largest current.", -10.0, 10.0),
    Parameter("limits.rate_a_per_s", 0.0, "A/s", "Largest rate of the current; 0 for none.", 0.0, 1e6),
)

_PUBLISHED = {
    "pi": {
        # section 7.4 as corrected: Kp 1.4 uA/um, KI 2.03e-5 A/(um sample) at 1 kHz
        "integrated": PidGains(kp=1.4, ki=2.03e4),
        "peltier": replace(PUBLISHED_PELTIER_PID, kd=0.0),
    },
    "pid": {"integrated": PidGains(kp=1.4, ki=2.03e4), "peltier": PUBLISHED_PELTIER_PID},
}
_GAINS = ("pid.kp", "pid.ki", "pid.kd")


def design_controller(
    kind: str, *, preset: str, sample_period_s: float, values: Mapping[str, Value]
) -> Controller:
    """Return the control law `kind`.

    Parameters
    ----------
    kind : one of `CONTROLLER_KINDS`
    preset : device preset; gives gains and limits that `values` does not
    sample_period_s : [s]
    values : what was set of `CONTROLLER_PARAMETERS` and `model.*`; gains in it are used, else a model is tuned for

    Raises
    ------
    ValueError : unknown kind, or parameters that make no controller.
    """
    if kind not in CONTROLLER_KINDS:
        raise ValueError(f"kind: found {kind!r}, need one of {', '.join(CONTROLLER_KINDS)}")
    point = operating_point(preset)
    lower, upper = float(values.get("limits.lower_a", 0.0)), float(values.get("limits.upper_a", 0.0))  # type: ignore[arg-type]
    if lower == upper:
        lower, upper = point.lower_a, point.upper_a
    rate = float(values.get("limits.rate_a_per_s", 0.0))  # type: ignore[arg-type]
    limits = CurrentLimits(lower, upper, rate or float("inf"))
    return pid_controller(_gains(kind, preset, sample_period_s, limits, values), limits, sample_period_s)


def _gains(
    kind: str, preset: str, sample_period_s: float, limits: CurrentLimits, values: Mapping[str, Value]
) -> PidGains:
    """Gains that were given; else those of the tuning rule for the model; without a model the published ones."""
    if any(name in values for name in _GAINS):
        return pid_from_parameters(values)
    if values.get("model.device"):
        # the simulation behind the rule loads the compiler: only once it is needed
        from vo2_control.model_tuning import tuned_from_model

        return tuned_from_model(values, sample_period_s, derivative=kind == "pid", limits=limits).gains
    return _PUBLISHED[kind][preset]
