"""Inverse compensation: from a deflection reference to the current that should produce it, sections 5.4 and 6.4.

reference -> inverse hysteresis model -> temperature -> (lead over the thermal lag) -> temperature surrogate [A].

The hysteresis memory follows the temperature the *thermal model* reaches, not the one wished for: a lag or a limit
on the current would else leave the inverse with loops that the device never ran. Direction changes come from
the reference alone, so sensor noise cannot make the inverse jump across the loop.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis import RobustInverse
from vo2_models.hysteresis.inverse_kernels import solve
from vo2_models.hysteresis.kernels import egpi_step
from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.hysteresis.prandtl_ishlinskii import PlayModel
from vo2_models.hysteresis.preisach.nonmonotonic import NonMonotonicPreisach
from vo2_models.hysteresis.preisach.nonmonotonic_inverse import NonMonotonicInverse
from vo2_models.parameters import Value
from vo2_models.validation import finite_array, nonnegative, positive_number

from vo2_control.controller import CurrentLimits

__all__ = [
    "Ahead",
    "HysteresisInverse",
    "InverseFeedforward",
    "NonMonotonicSolver",
    "PlayInverse",
    "ThermalPath",
    "feedforward_from_model",
]

Floats = NDArray[np.float64]


class HysteresisInverse(Protocol):
    """A deflection model with memory that can be asked for a temperature."""

    def wish(self, deflection_m: float) -> float:
        """Temperature [degC] to go to next for this deflection [m]; the memory stays as it is."""
        ...

    def move(self, temperature_degc: float) -> float:
        """Go there; return the deflection [m]."""
        ...

    def reset(self) -> None:
        """Forget everything: a long rest in the cold."""
        ...


class PlayInverse:
    """GPI or EGPI by the inverse that finds every reachable output.

    Parameters
    ----------
    model : deflection [m] over temperature [degC]
    temperature_range : (low, high) temperatures allowed [degC]
    """

    def __init__(self, model: PlayModel, temperature_range: tuple[float, float]) -> None:
        self._model, self._low = model, temperature_range[0]
        self._packed = RobustInverse(model, temperature_range).packed
        self.reset()

    def reset(self) -> None:
        self._state = self._model.initial_state(v=self._low)

    def wish(self, deflection_m: float) -> float:
        return float(solve(deflection_m, self._packed, self._state.copy()))

    def move(self, temperature_degc: float) -> float:
        return float(egpi_step(temperature_degc, self._model.packed, self._state))


class LawSolver:
    """Any law of the registry by its own inverse.

    Parameters
    ----------
    law : deflection [m] over temperature [degC]
    temperature_range : (low, high) temperatures allowed [degC]
    """

    def __init__(self, law: Law, temperature_range: tuple[float, float]) -> None:
        self._law, self._low = law, temperature_range[0]
        self._inverse = law.inverse(temperature_range)
        self.reset()

    def reset(self) -> None:
        self._state = self._law.settle(self._low)

    def wish(self, deflection_m: float) -> float:
        return self._inverse.invert(deflection_m, self._state.copy()).input

    def move(self, temperature_degc: float) -> float:
        return self._law.step(temperature_degc, self._state)


class NonMonotonicSolver:
    """Non-monotonic Preisach model by the algorithm of section 5.4.1.

    A deflection that needs two temperatures is approached by the first until the memory has changed.
    """

    def __init__(self, model: NonMonotonicPreisach) -> None:
        self._inverse = NonMonotonicInverse(model)
        self._range = float(model.operator.walls[0]), float(model.operator.walls[-1])
        self.reset()

    def reset(self) -> None:
        self._state = self._inverse.model.initial_memory()

    def wish(self, deflection_m: float) -> float:
        return float(self._inverse.update(deflection_m, self._state.copy()).temperatures[0])

    def move(self, temperature_degc: float) -> float:
        low, high = self._range
        return float(self._inverse.model.step(min(max(temperature_degc, low), high), self._state))


@dataclass(frozen=True)
class ThermalPath:
    """tau dT/dt = T0 + k1 i + k2 i^2 - T after a dead time, as fitted models have it.

    Attributes
    ----------
    ambient_degc : T0
    linear_k_per_a, square_k_per_a2 : k1 [K/A], k2 [K/A^2]; one of them is 0
    time_constant_s, dead_time_s : [s]
    """

    ambient_degc: float
    linear_k_per_a: float
    square_k_per_a2: float
    time_constant_s: float
    dead_time_s: float = 0.0

    def __post_init__(self) -> None:
        positive_number(self.time_constant_s, "time_constant_s")
        nonnegative(finite_array(self.dead_time_s, "dead_time_s", ndim=0).reshape(1), "dead_time_s")
        if (self.linear_k_per_a == 0) == (self.square_k_per_a2 == 0):
            raise ValueError(
                f"linear_k_per_a, square_k_per_a2: found {self.linear_k_per_a:g} and {self.square_k_per_a2:g}, "
                "need exactly one other than 0"
            )

    def steady(self, current_a: float) -> float:
        """Temperature [degC] that the current holds."""
        return self.ambient_degc + (self.linear_k_per_a + self.square_k_per_a2 * current_a) * current_a

    def holding(self, temperature_degc: float) -> float:
        """Current [A] that holds the temperature (7.2); 0 A where a heater would have to cool."""
        rise = temperature_degc - self.ambient_degc
        if self.square_k_per_a2:
            return math.sqrt(max(rise / self.square_k_per_a2, 0.0))
        return rise / self.linear_k_per_a


@dataclass(frozen=True)
class Ahead:
    """What the feedforward decides: current [A], and the deflection [m] the device should show at this sample."""

    current_a: float
    expected_m: float


@dataclass
class InverseFeedforward:
    """Open-loop current for a deflection reference, sample by sample.

    With feedback, give the controller `current_a` as its feedforward, and as its reference either the reference itself
    (the quicker) or `expected_m` (it then corrects only what the model gets wrong and does not fight known lags).

    Attributes
    ----------
    inverse : hysteresis model with memory
    thermal : path from current to temperature
    limits : of the current
    sample_period_s : [s]
    response_s : time constant with which the temperature is led to the wished one; 0 for the fastest the limits allow
    lead : False for the current that holds the wished temperature: the thermal lag then remains
    rate_k_per_s : largest rate at which the temperature is led [K/s]. It spreads the jump across the loop after every
        reversal, which is what costs current, without adding a lag where the reference changes slowly, as a longer
        `response_s` would.
    """

    inverse: HysteresisInverse
    thermal: ThermalPath
    limits: CurrentLimits
    sample_period_s: float
    response_s: float = 0.0
    lead: bool = True
    rate_k_per_s: float = math.inf
    _temperature: float = field(init=False)
    _expected: deque[float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        positive_number(self.sample_period_s, "sample_period_s")
        if not self.response_s >= 0:
            raise ValueError(f"response_s: found {self.response_s}, need 0 s or more")
        if not self.rate_k_per_s > 0:
            raise ValueError(f"rate_k_per_s: found {self.rate_k_per_s}, need a number above 0")
        self._decay = math.exp(-self.sample_period_s / self.thermal.time_constant_s)
        self.reset()

    def reset(self) -> None:
        """Start from a long rest without current."""
        self.inverse.reset()
        self._temperature = self.thermal.ambient_degc
        start = self.inverse.move(self._temperature)
        # the current of this sample shows in the next one, after the dead time
        delay = 1 + round(self.thermal.dead_time_s / self.sample_period_s)
        self._expected = deque([start] * delay, maxlen=delay)
        self._current = min(max(0.0, self.limits.lower_a), self.limits.upper_a)

    def update(self, reference_m: float) -> Ahead:
        """Advance one sample.

        Raises
        ------
        ValueError : a reference that is not finite; nothing has moved then.
        """
        if not math.isfinite(reference_m):
            raise ValueError(f"reference_m: found {reference_m}, need a finite number")
        wished = self.inverse.wish(reference_m)
        thermal, now, decay = self.thermal, self._temperature, self._decay
        if not self.lead:
            current = thermal.holding(wished)
        else:
            share = 1.0 if self.response_s == 0 else -math.expm1(-self.sample_period_s / self.response_s)
            travel = self.rate_k_per_s * self.sample_period_s
            step = min(max(share * (wished - now), -travel), travel)
            current = thermal.holding((now + step - decay * now) / (1 - decay))
        most = self.limits.rate_a_per_s * self.sample_period_s
        current = min(max(current, self._current - most), self._current + most)
        self._current = min(max(current, self.limits.lower_a), self.limits.upper_a)
        expected = self._expected[0]
        self._temperature = decay * now + (1 - decay) * thermal.steady(self._current)
        self._expected.append(self.inverse.move(self._temperature))
        return Ahead(self._current, expected)

    def run(self, reference_m: ArrayLike) -> tuple[Floats, Floats]:
        """Return currents [A] and expected deflections [m] (n,) for a whole reference (n,) [m]."""
        rows = [self.update(r) for r in finite_array(reference_m, "reference_m").tolist()]
        return np.array([a.current_a for a in rows]), np.array([a.expected_m for a in rows])


def _inverse_of(law: Law, temperature_range: tuple[float, float]) -> HysteresisInverse:
    if isinstance(law, PlayBank):
        return PlayInverse(law.egpi(), temperature_range)
    # that of section 5.4.1 visits the ends of its grid
    if isinstance(law, NonMonotonicPreisach) and isinstance(
        law.inverse(temperature_range), NonMonotonicInverse
    ):
        return NonMonotonicSolver(law)
    return LawSolver(law, temperature_range)


def feedforward_from_model(
    parameters: Mapping[str, Value],
    sample_period_s: float,
    *,
    response_s: float | None = None,
    rate_k_per_s: float = math.inf,
    limits: CurrentLimits | None = None,
) -> InverseFeedforward:
    """Return the compensator of a fitted model in flat `model.*` parameters.

    Parameters
    ----------
    response_s : None for two sample periods: fast, without demanding the limits at every reversal
    rate_k_per_s : see `InverseFeedforward`
    limits : None for the preset's current range
    parameters : flat `model.*` parameters
    sample_period_s : [s]

    Raises
    ------
    ValueError : no model, a model without deflection, or one whose film is its own heater.
    """
    model = DeviceModel.from_parameters(parameters)
    if gain := model.scalars["thermal.power_gain"]:
        raise ValueError(
            f"model.thermal.power_gain: found {gain:.4g} K/W, need a heater of constant resistance: the film heats itself, "
            "and the drive for a temperature depends on its state; control it without feedforward"
        )
    if not model.deflection.present:
        raise ValueError(
            "model.deflection: found no law, need one to invert; fit a recording with deflection"
        )
    nominal, values = preset(model.device), model.scalars
    ends = sorted(nominal.steady_temperature(i) for i in nominal.operating_range)
    cold = min(ends[0], values["thermal.ambient"])
    thermal = ThermalPath(
        values["thermal.ambient"],
        values["thermal.linear_gain"],
        values["thermal.square_gain"],
        values["thermal.time_constant"],
        values["driver.dead_time"],
    )
    return InverseFeedforward(
        _inverse_of(model.deflection, (cold, ends[1])),
        thermal,
        limits or CurrentLimits(*nominal.current_range),
        sample_period_s,
        2 * sample_period_s if response_s is None else response_s,
        rate_k_per_s=rate_k_per_s,
    )
