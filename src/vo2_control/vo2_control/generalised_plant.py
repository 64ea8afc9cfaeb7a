"""The generalised plant of section 8.3, assembled from the block diagram of Fig. 8.3b.

                    z_delta   w_delta               n1          n2
                       |         |                  |           |
                       |  delta  |                 W_n1        W_n2
    y_ref -->(+)--K--u-->(+)--> A(s) --T--> K_c -->(+)-- y -->(+)-- y_self --.
             -^      |    ^                         |                        |
              |     W_u  W_d <- d                 W_e (y_ref - y) = e~       |
              |      u~                                                      |
              '--------------------------------------------------------------'

The printed matrices of the dissertation have lost entries and are not used. Inside the design deflection is in
micrometres, as the printed weights are; `vo2_control.hinf` converts the finished controller to A/m once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Literal

import numpy as np
from vo2_models.parameters import Parameter, Value
from vo2_models.validation import positive_number

from vo2_control.sampled_loop import ThermalLag

if TYPE_CHECKING:
    import control

__all__ = [
    "DESIGN_PARAMETERS",
    "INPUTS",
    "METRE_PER_DESIGN_UNIT",
    "OUTPUTS",
    "LeadLag",
    "RobustDesign",
    "design_from_parameters",
    "generalised_plant",
]

METRE_PER_DESIGN_UNIT = 1e-6
INPUTS = ("w_delta", "d", "n1", "n2", "y_ref", "u")
OUTPUTS = ("z_delta", "e_weighted", "u_weighted", "v")
"""Signals of the generalised plant; v = y_ref - y_self is what the controller sees."""

Uncertainty = Literal["time_constant", "multiplicative"]


@dataclass(frozen=True)
class LeadLag:
    """Weight gain (s / zero + 1) / (s / pole + 1); an infinite corner [rad/s] leaves its factor out."""

    gain: float
    zero_rad_s: float = math.inf
    pole_rad_s: float = math.inf

    def __post_init__(self) -> None:
        if not math.isfinite(self.gain) or self.gain == 0:
            raise ValueError(f"gain: found {self.gain}, need a finite number other than 0")
        for name in ("zero_rad_s", "pole_rad_s"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: found {getattr(self, name)}, need a number above 0 (or infinity)")
        if math.isinf(self.pole_rad_s) and math.isfinite(self.zero_rad_s):
            raise ValueError("pole_rad_s: found infinity beside a finite zero, need a proper weight")

    def system(self, inputs: str, outputs: str) -> control.StateSpace:
        """The weight as a state-space system between two named signals."""
        import control

        numerator = [0.0 if math.isinf(self.zero_rad_s) else self.gain / self.zero_rad_s, self.gain]
        denominator = [0.0 if math.isinf(self.pole_rad_s) else 1 / self.pole_rad_s, 1.0]
        if denominator[0] == 0:
            return control.ss([], [], [], [[self.gain]], inputs=inputs, outputs=outputs, name=f"W_{outputs}")
        return control.ss(
            control.tf(numerator, denominator), inputs=inputs, outputs=outputs, name=f"W_{outputs}"
        )

    def response(self, frequency_rad_s: np.ndarray) -> np.ndarray:
        """Frequency response (m,)."""
        s = 1j * frequency_rad_s
        return self.gain * (1 + s / self.zero_rad_s) / (1 + s / self.pole_rad_s)


@dataclass(frozen=True)
class RobustDesign:
    """Everything a robust design is made from; the defaults are the published ones, (8.1) and (8.5) to (8.9).

    Attributes
    ----------
    current_gain_k_per_a : steady temperature over current [K/A], the printed -A_0: negative current heats
    time_constant_s, dead_time_s : tau and tau_d of (8.1) [s]
    slope_m_per_k : K_c of (8.2) [m/K]
    uncertainty : `time_constant`: tau (1 + spread delta), as published; `multiplicative`: temperature times
        1 + W_m delta, for a set identified from data
    time_constant_spread : relative spread of tau
    effort : W_u; disturbance : W_d; performance : W_e; plant_noise : W_n1; sensing_noise : W_n2, with deflection
        in micrometres and current in ampere
    multiplicative : W_m
    """

    current_gain_k_per_a: float = -50.0
    time_constant_s: float = 25.0
    dead_time_s: float = 0.375
    slope_m_per_k: float = 5.9e-6
    uncertainty: Uncertainty = "time_constant"
    time_constant_spread: float = 0.2
    effort: LeadLag = field(default_factory=lambda: LeadLag(0.12, 1.0, 10.0))
    disturbance: LeadLag = field(default_factory=lambda: LeadLag(0.1, 2.0, 1.0))
    performance: LeadLag = field(default_factory=lambda: LeadLag(0.09, math.inf, 10.0))
    plant_noise: LeadLag = field(default_factory=lambda: LeadLag(0.002, 1.0, 100.0))
    sensing_noise: LeadLag = field(default_factory=lambda: LeadLag(0.002, 1.0, 100.0))
    multiplicative: LeadLag = field(default_factory=lambda: LeadLag(0.3, 0.1, 1.0))

    def __post_init__(self) -> None:
        for name in ("current_gain_k_per_a", "slope_m_per_k"):
            value = getattr(self, name)
            if not math.isfinite(value) or value == 0:
                raise ValueError(
                    f"{name}: found {value}, need a finite number other than 0: the current would not move the "
                    "deflection (uncontrollable plant)"
                )
        positive_number(self.time_constant_s, "time_constant_s")
        positive_number(self.dead_time_s, "dead_time_s")
        if not 0 <= self.time_constant_spread < 1:
            raise ValueError(f"time_constant_spread: found {self.time_constant_spread}, need 0 to below 1")
        if self.uncertainty not in ("time_constant", "multiplicative"):
            raise ValueError(f"uncertainty: found {self.uncertainty!r}, need time_constant or multiplicative")

    @property
    def plant(self) -> ThermalLag:
        """The nominal plant from current [A] to deflection [m], with its exact delay."""
        return ThermalLag(
            self.current_gain_k_per_a * self.slope_m_per_k, self.time_constant_s, self.dead_time_s
        )


def generalised_plant(design: RobustDesign) -> control.StateSpace:
    """Return P(s) with inputs `INPUTS` and outputs `OUTPUTS`; dead time as a first-order Pade term (8.1).

    tau (1 + spread delta) T' = -T + K i is opened at delta: z_delta = spread tau T', w_delta = delta z_delta.

    >>> generalised_plant(RobustDesign()).nstates
    7

    Parameters
    ----------
    design : plant, uncertainty and weights
    """
    # a second to load, and every controller node declares the parameters of this module
    import control

    tau, half = design.time_constant_s, design.dead_time_s / 2
    pade = control.ss(
        control.tf([-half, 1.0], [half, 1.0]), inputs="i_total", outputs="i_late", name="dead_time"
    )
    spread = design.time_constant_spread
    if design.uncertainty == "time_constant":
        gain = design.current_gain_k_per_a
        lag = control.ss(
            [[-1 / tau]],
            [[gain / tau, -1 / tau]],
            [[1.0], [-spread]],
            [[0.0, 0.0], [spread * gain, -spread]],
            inputs=["i_late", "w_delta"],
            outputs=["t_film", "z_delta"],
            name="thermal",
        )
        thermal = [lag]
    else:
        lag = control.ss(
            control.tf([design.current_gain_k_per_a], [tau, 1.0]),
            inputs="i_late",
            outputs="t_nominal",
            name="thermal",
        )
        thermal = [
            lag,
            design.multiplicative.system("t_nominal", "z_delta"),
            control.summing_junction(["t_nominal", "w_delta"], "t_film", name="sum_t"),
        ]
    slope = design.slope_m_per_k / METRE_PER_DESIGN_UNIT
    blocks = [
        design.effort.system("u", "u_weighted"),
        design.disturbance.system("d", "i_disturbance"),
        control.summing_junction(["u", "i_disturbance"], "i_total", name="sum_i"),
        pade,
        *thermal,
        control.ss([], [], [], [[slope]], inputs="t_film", outputs="y_model", name="slope"),
        design.plant_noise.system("n1", "y_noise"),
        design.sensing_noise.system("n2", "y_sensing"),
        control.summing_junction(["y_model", "y_noise"], "y", name="sum_y"),
        control.summing_junction(["y", "y_sensing"], "y_self", name="sum_y_self"),
        control.summing_junction(["y_ref", "-y"], "e", name="sum_e"),
        control.summing_junction(["y_ref", "-y_self"], "v", name="sum_v"),
        design.performance.system("e", "e_weighted"),
    ]
    return control.interconnect(blocks, inputs=list(INPUTS), outputs=list(OUTPUTS), name="P")


_WEIGHTS = tuple(f.name for f in fields(RobustDesign) if f.type == "LeadLag")
_SCALARS = {
    "current_gain_k_per_a": (
        "K/A",
        "Steady temperature over current; negative: negative current heats.",
        None,
    ),
    "time_constant_s": ("s", "Time constant of the heater.", 1e-9),
    "dead_time_s": (
        "s",
        "Time between a change of the current and the first change of the temperature.",
        0.0,
    ),
    "slope_m_per_k": ("m/K", "Slope of deflection over temperature across the transition.", None),
    "time_constant_spread": (
        "1",
        "Relative spread of the time constant that the design must tolerate.",
        0.0,
    ),
}


def _parameters() -> tuple[Parameter, ...]:
    nominal = RobustDesign()
    scalars = [
        Parameter(f"hinf.{name}", getattr(nominal, name), unit, text, lower)
        for name, (unit, text, lower) in _SCALARS.items()
    ]
    kind = Parameter(
        "hinf.uncertainty",
        nominal.uncertainty,
        "",
        "What the design tolerates: a spread of the time constant, or a multiplicative error of the temperature.",
        choices=("time_constant", "multiplicative"),
    )
    weights = []
    for name in _WEIGHTS:
        weight = getattr(nominal, name)
        weights.append(
            Parameter(f"hinf.{name}.gain", weight.gain, "1", f"Weight {name}: gain at zero frequency.")
        )
        for corner in ("zero_rad_s", "pole_rad_s"):
            value = getattr(weight, corner)
            weights.append(
                Parameter(
                    f"hinf.{name}.{corner}",
                    0.0 if math.isinf(value) else value,
                    "rad/s",
                    f"Weight {name}: corner of the {corner[:4]}; 0 for none.",
                    lower=0.0,
                )
            )
    return (*scalars, kind, *weights)


DESIGN_PARAMETERS: tuple[Parameter, ...] = _parameters()
"""The design as parameters that a node declares; `design_from_parameters` reads them back."""


def design_from_parameters(values: Mapping[str, Value]) -> RobustDesign:
    """Return the design in `values`, a mapping from names of `DESIGN_PARAMETERS`; absent ones take the published value.

    Raises
    ------
    ValueError : a value out of range, naming the parameter.
    """
    checked = {p.name: p.check(values.get(p.name, p.default)) for p in DESIGN_PARAMETERS}

    def corner(name: str) -> float:
        value = float(checked[name])  # type: ignore[arg-type]
        return value if value > 0 else math.inf

    arguments: dict[str, object] = {name: checked[f"hinf.{name}"] for name in (*_SCALARS, "uncertainty")}
    for name in _WEIGHTS:
        try:
            arguments[name] = LeadLag(
                float(checked[f"hinf.{name}.gain"]),  # type: ignore[arg-type]
                corner(f"hinf.{name}.zero_rad_s"),
                corner(f"hinf.{name}.pole_rad_s"),
            )
        except ValueError as error:
            raise ValueError(f"hinf.{name}.{error}") from error
    return RobustDesign(**arguments)  # type: ignore[arg-type]
