"""Every control law by name: from parameters to a `Controller`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from vo2_interface.model import operating_point
from vo2_models.device.description import check_model_of
from vo2_models.device.description import preset as description
from vo2_models.parameters import Parameter, Value
from vo2_models.recording import TIP_DEFLECTION
from vo2_models.units import shown_unit

from vo2_control.controller import Controller, CurrentLimits, LinearController, LinearLaw
from vo2_control.generalised_plant import DESIGN_PARAMETERS, design_from_parameters
from vo2_control.pid import (
    PID_PARAMETERS,
    PUBLISHED_PELTIER_PID,
    PidGains,
    pid_controller,
    pid_from_parameters,
)
from vo2_control.zpk import ZPK_PARAMETERS, law_from_zpk

if TYPE_CHECKING:
    from vo2_control.feedforward import InverseFeedforward

__all__ = [
    "CONTROLLER_KINDS",
    "CONTROLLER_PARAMETERS",
    "LIMIT_PARAMETERS",
    "check_device_limits",
    "current_limits",
    "design_controller",
    "design_feedforward",
    "open_loop",
    "reach",
]

CONTROLLER_KINDS = ("pi", "pid", "hinf", "zpk")

DRIVE = 1e6
"""Most that a parameter takes, of any drive; the limits of the device are narrower, see `check_device_limits`."""
LIMIT_PARAMETERS = (
    Parameter(
        "limits.lower_a",
        0.0,
        "A",
        "Smallest current, or drive of a device that has another; equal to upper_a for the operating range.",
        -DRIVE,
        DRIVE,
    ),
    Parameter("limits.upper_a", 0.0, "A", "Largest current or drive.", -DRIVE, DRIVE),
    Parameter("limits.rate_a_per_s", 0.0, "A/s", "Largest rate of the current; 0 for none.", 0.0, 1e6),
)
_OPERATING = Parameter(
    "operating_a",
    0.0,
    "A",
    "Current about which a law was designed, added to what it commands; a law without integral action needs it.",
    -DRIVE,
    DRIVE,
)
CONTROLLER_PARAMETERS = (*PID_PARAMETERS, *DESIGN_PARAMETERS, *ZPK_PARAMETERS, *LIMIT_PARAMETERS, _OPERATING)

_PUBLISHED = {
    "pi": {
        # section 7.4 as corrected: Kp 1.4 uA/um, KI 2.03e-5 A/(um sample) at 1 kHz
        "integrated": PidGains(kp=1.4, ki=2.03e4),
        "peltier": replace(PUBLISHED_PELTIER_PID, kd=0.0),
    },
    "pid": {
        "integrated": PidGains(kp=1.4, ki=2.03e4),
        "peltier": PUBLISHED_PELTIER_PID,
        "peltier_chapter8": PUBLISHED_PELTIER_PID,
    },
}
_REACH_LEVELS = 400
_GAINS = ("pid.kp", "pid.ki", "pid.kd")
_SHARE_OF_RANGE = 1e-3
"""Share of the deflection range that is no more than noise: a gain by which it swings the current over all that the
device bears controls nothing."""


def design_controller(
    kind: str, *, preset: str, sample_period_s: float, values: Mapping[str, Value]
) -> Controller:
    """Return the control law `kind`.

    Parameters
    ----------
    kind : one of `CONTROLLER_KINDS`
    preset : device preset; gives gains and limits that `values` does not
    sample_period_s : [s]
    values : what was set of `CONTROLLER_PARAMETERS` and `model.*`; gains (`pid.*`, `hinf.*`) in it are used, else a model is
        designed for; without both the published ones. Of `zpk` its own only

    Raises
    ------
    ValueError : unknown kind, a model of another device, or parameters that make no controller; `DesignRefused` for a
        robust design that fails a check.
    """
    if kind not in CONTROLLER_KINDS:
        raise ValueError(f"kind: found {kind!r}, need one of {', '.join(CONTROLLER_KINDS)}")
    if device := values.get("model.device"):
        check_model_of(str(device), preset)
    check_device_limits(preset, sample_period_s, values)
    limits = current_limits(preset, values)
    if kind == "hinf":
        # the synthesis libraries take a second to load: only for who designs with them
        if values.get("model.device") and not any(name.startswith("hinf.") for name in values):
            from vo2_control.model_hinf import robust_from_model

            controller = robust_from_model(values, sample_period_s, limits=limits).controller(limits)
        else:
            from vo2_control.discretise import robust_law

            design = design_from_parameters(values)
            controller = robust_law(design, sample_period_s, expected_sign=_sign(preset)).controller(limits)
    elif kind == "zpk":
        law = law_from_zpk(values, sample_period_s, expected_sign=_sign(preset))
        controller = LinearController(law, limits)
    else:
        gains = _gains(kind, preset, sample_period_s, limits, values)
        controller = pid_controller(gains, limits, sample_period_s)
    operating = float(values.get(_OPERATING.name, 0.0))  # type: ignore[arg-type]
    if operating:
        return LinearController(replace(controller.law, operating_a=operating), limits)
    return controller


def check_device_limits(preset: str, sample_period_s: float, values: Mapping[str, Value]) -> None:
    """Refuse currents that the device does not bear, and gains that swing it from end to end at every sample.

    Parameters
    ----------
    preset : device preset
    sample_period_s : [s]
    values : what was set of `CONTROLLER_PARAMETERS`; order of the limits and sign of the gains are judged by the design

    Raises
    ------
    ValueError : name, what was found, what the device bears.
    """
    point = operating_point(preset)
    for name in ("limits.lower_a", "limits.upper_a", _OPERATING.name):
        value = float(values.get(name, 0.0))  # type: ignore[arg-type]
        if not point.least_a <= value <= point.most_a:
            raise ValueError(
                f"{name}: found {value:g} {point.unit}, need {point.least_a:g} to {point.most_a:g} {point.unit}, which "
                f"{preset} bears"
            )
    response = description(preset).units.get(TIP_DEFLECTION, "m")
    shown, to_shown = shown_unit(response)
    span, unit = point.most_a - point.least_a, f"{point.unit}/{response}"
    if values.get("pid.coordinate") == "heating_power":
        span, unit = max(point.most_a**2, point.least_a**2), f"{point.unit}^2/{response}"
    most = span / (_SHARE_OF_RANGE * point.deflection_range_m)
    kp, ki, kd, filter_s = (float(values.get(name, 0.0)) for name in (*_GAINS, "pid.derivative_filter_s"))  # type: ignore[arg-type]
    per_gain = (1.0, sample_period_s, 1.0 / (filter_s + sample_period_s))
    for name, gain, factor in zip(_GAINS, (kp, ki, kd), per_gain, strict=True):
        if abs(gain) * factor > most:
            raise ValueError(
                f"{name}: found {gain:g}, need at most {most / factor:.3g} ({unit} at once): beyond, "
                f"{to_shown * _SHARE_OF_RANGE * point.deflection_range_m:.2g} {shown} of noise swing the drive from end to "
                "end"
            )


def current_limits(preset: str, values: Mapping[str, Value]) -> CurrentLimits:
    """Return the limits in `values`, names of `LIMIT_PARAMETERS`; the preset's operating range where both ends agree.

    Raises
    ------
    ValueError : ends in the wrong order.
    """
    lower, upper, rate = (float(values.get(p.name, p.default)) for p in LIMIT_PARAMETERS)  # type: ignore[arg-type]
    if lower == upper:
        point = operating_point(preset)
        lower, upper = point.lower_a, point.upper_a
    return CurrentLimits(lower, upper, rate or float("inf"))


def design_feedforward(
    *, preset: str, sample_period_s: float, values: Mapping[str, Value]
) -> InverseFeedforward:
    """Return the inverse compensation of the model in `values` (`model.*`) within the limits in it.

    Parameters
    ----------
    sample_period_s : [s]

    Raises
    ------
    ValueError : no model, a model without deflection or of another preset.
    """
    # the inverse loads the compiler: only once a model is there
    from vo2_control.feedforward import feedforward_from_model

    device = values.get("model.device", "")
    if not device:
        raise ValueError(
            "model.device: found none, need a model to invert; run the identifier (~/start), or load a file that "
            "it or fit wrote (ros2 param load, --params-file)"
        )
    check_model_of(str(device), preset)
    check_device_limits(preset, sample_period_s, values)
    return feedforward_from_model(values, sample_period_s, limits=current_limits(preset, values))


def reach(ahead: InverseFeedforward) -> tuple[float, float]:
    """Return the lowest and highest deflection [m] of the model on its major loop within the limits; resets `ahead`."""
    cold, hot = sorted(ahead.thermal.steady(i) for i in (ahead.limits.lower_a, ahead.limits.upper_a))
    rise = np.linspace(cold, hot, _REACH_LEVELS)
    ahead.reset()
    loop = [ahead.inverse.move(t) for t in (*rise, *rise[::-1])]
    ahead.reset()
    return min(loop), max(loop)


def open_loop(limits: CurrentLimits, sample_period_s: float) -> Controller:
    """Return the law without feedback: the feedforward current within the limits.

    Parameters
    ----------
    sample_period_s : [s]
    """
    nothing = LinearLaw(
        a=np.zeros((0, 0)),
        b=np.zeros((0, 2)),
        c=np.zeros(0),
        d=np.zeros(2),
        conditioning=np.zeros(0),
        sample_period_s=sample_period_s,
    )
    return LinearController(nothing, limits)


def _sign(preset: str) -> int:
    """Sign of deflection over current: on every preset deflection grows with temperature."""
    point = operating_point(preset)
    return int(math.copysign(1, point.hot_a - point.cold_a))


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
    if preset not in _PUBLISHED[kind]:
        raise ValueError(
            f"preset: found {preset!r}, for which no gains are published, need {', '.join(_GAINS)} or a model to tune for: "
            "load the file that fit wrote"
        )
    return _PUBLISHED[kind][preset]
