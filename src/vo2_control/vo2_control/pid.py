"""PI and PID with two degrees of freedom, derivative filter and back-calculation, as a sampled linear law."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from vo2_models.parameters import Parameter, Value
from vo2_models.validation import positive_number

from vo2_control.controller import Coordinate, CurrentLimits, LinearController, LinearLaw

__all__ = [
    "PID_PARAMETERS",
    "PUBLISHED_PELTIER_PID",
    "PidGains",
    "pid_controller",
    "pid_from_parameters",
    "pid_law",
]


@dataclass(frozen=True)
class PidGains:
    """Gains of u = Kp (b r - y) + Ki int(r - y) dt + Kd d/dt (c r - y) filtered.

    Units are per metre of deflection; with the coordinate `heating_power` read A^2 where A stands.

    Attributes
    ----------
    kp : proportional gain [A/m]
    ki : integral gain [A/(m s)]
    kd : derivative gain [A s/m]
    derivative_filter_s : time constant of the first-order filter of the derivative [s]
    reference_weight : b, share of the reference that reaches the proportional part
    reference_derivative_weight : c, share of the reference that reaches the derivative part; 0 spares the
        actuator a kick at reference steps
    tracking_time_s : time constant with which a limited output unloads the integrator [s]; None for the
        customary Ti, or sqrt(Ti Td) with derivative action (Astrom and Hagglund, Advanced PID Control)
    coordinate : what u is, see `vo2_control.controller.Coordinate`
    """

    kp: float
    ki: float
    kd: float = 0.0
    derivative_filter_s: float = 0.0
    reference_weight: float = 1.0
    reference_derivative_weight: float = 0.0
    tracking_time_s: float | None = None
    coordinate: Coordinate = "current"

    def __post_init__(self) -> None:
        for name in (
            "kp",
            "ki",
            "kd",
            "derivative_filter_s",
            "reference_weight",
            "reference_derivative_weight",
        ):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"{name}: found {getattr(self, name)}, need a finite number")
        if self.derivative_filter_s < 0:
            raise ValueError(f"derivative_filter_s: found {self.derivative_filter_s:g}, need 0 s or more")
        gains = [g for g in (self.kp, self.ki, self.kd) if g != 0]
        if gains and min(gains) < 0 < max(gains):
            raise ValueError(
                f"kp, ki, kd: found {self.kp:g}, {self.ki:g}, {self.kd:g}, need gains of one sign"
            )
        if self.tracking_time_s is not None:
            positive_number(self.tracking_time_s, "tracking_time_s")


PUBLISHED_PELTIER_PID = PidGains(
    kp=-0.059e6, ki=-0.004e6, kd=-0.0136e6, derivative_filter_s=0.125, reference_derivative_weight=1.0
)
"""The PID of section 8.3.2, printed in A/um without the plant's sign: negative, as negative current heats.
The printed derivative has no filter; one sample period makes it realisable at 125 ms."""


def pid_law(gains: PidGains, sample_period_s: float) -> LinearLaw:
    """Return the law with states (integral, filtered b r - y of the derivative), by backward differences.

    The derivative is Kd (q - 1) / ((Tf + Ts) q - Tf); the integral includes the present sample, so that the
    loop has no more delay than the zero-order hold. A limited output moves the integral by Ts/Tt of what
    the limits removed, at most all of it.

    >>> pid_law(PidGains(kp=100.0, ki=5.0), 0.001).order
    2

    Parameters
    ----------
    gains : in the law's coordinate
    sample_period_s : [s]
    """
    period = positive_number(sample_period_s, "sample_period_s")
    blend = gains.derivative_filter_s / (gains.derivative_filter_s + period)
    slope = gains.kd / (gains.derivative_filter_s + period)
    step = gains.ki * period
    b, c = gains.reference_weight, gains.reference_derivative_weight
    unload = 0.0
    if gains.ki != 0:
        tracking = gains.tracking_time_s
        if tracking is None:
            integral_time = gains.kp / gains.ki
            derivative_time = gains.kd / gains.kp if gains.kp else 0.0
            tracking = math.sqrt(integral_time * derivative_time) if derivative_time > 0 else integral_time
        unload = min(1.0, period / max(tracking, period))
    return LinearLaw(
        a=np.array([[1.0, 0.0], [0.0, blend]]),
        b=np.array([[step, -step], [(1 - blend) * c, -(1 - blend)]]),
        c=np.array([1.0, -slope]),
        d=np.array([gains.kp * b + step + slope * c, -gains.kp - step - slope]),
        conditioning=np.array([unload, 0.0]),
        sample_period_s=period,
        coordinate=gains.coordinate,
    )


def pid_controller(gains: PidGains, limits: CurrentLimits, sample_period_s: float) -> LinearController:
    """Return a PI (kd = 0) or PID controller.

    Parameters
    ----------
    gains : see `PidGains`
    limits : range and rate of the commanded current
    sample_period_s : [s]

    Examples
    --------
    >>> pi = pid_controller(PidGains(kp=100.0, ki=2e4), CurrentLimits(0.0, 0.012), 0.001)
    >>> _ = pi.reset(0.005, reference_m=30e-6, estimate_m=30e-6)
    >>> round(pi.update(30e-6, 30e-6), 9)
    0.005
    """
    return LinearController(pid_law(gains, sample_period_s), limits)


PID_PARAMETERS: tuple[Parameter, ...] = (
    Parameter(
        "pid.kp",
        0.0,
        "A/m",
        "Proportional gain (A^2/m in the coordinate heating_power); where no gain is set, they are tuned for the model, and "
        "without one are the published ones of the preset.",
    ),
    Parameter("pid.ki", 0.0, "A/(m s)", "Integral gain (A^2/(m s) in the coordinate heating_power)."),
    Parameter("pid.kd", 0.0, "A s/m", "Derivative gain; 0 makes it a PI."),
    Parameter("pid.derivative_filter_s", 0.0, "s", "Time constant of the derivative's filter.", lower=0.0),
    Parameter("pid.reference_weight", 1.0, "1", "Share of the reference in the proportional part.", 0.0, 2.0),
    Parameter(
        "pid.reference_derivative_weight",
        0.0,
        "1",
        "Share of the reference in the derivative part.",
        0.0,
        1.0,
    ),
    Parameter(
        "pid.tracking_time_s", 0.0, "s", "Anti-windup time constant; 0 for the customary one.", lower=0.0
    ),
    Parameter(
        "pid.coordinate",
        "current",
        "",
        "What the law computes: the current, or its square (linear in a Joule heater's temperature).",
        choices=("current", "heating_power"),
    ),
)
"""The gains as parameters that a node declares; `pid_from_parameters` reads them back."""


def pid_from_parameters(values: Mapping[str, Value]) -> PidGains:
    """Return the gains in `values`, a mapping from the names of `PID_PARAMETERS`; absent ones take defaults.

    Raises
    ------
    ValueError : a value outside its range, naming the parameter.
    """
    checked = {p.name.removeprefix("pid."): p.check(values.get(p.name, p.default)) for p in PID_PARAMETERS}
    checked["tracking_time_s"] = checked["tracking_time_s"] or None  # type: ignore[assignment]
    return PidGains(**checked)  # type: ignore[arg-type]
