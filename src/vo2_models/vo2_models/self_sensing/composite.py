"""Composite self-sensing, section 7.2: resistance -> temperature surrogate -> deflection.

Both hysteresis laws take the temperature as input, so the scheme runs the inverse of the resistance law
(7.4) and feeds the temperature it finds to the deflection law (7.5). It follows loops of deflection against
resistance that are not nested, which no single operator between the two can.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.description import preset
from vo2_models.hysteresis import EGPI, RobustInverse
from vo2_models.hysteresis.inverse_kernels import invert_update
from vo2_models.hysteresis.kernels import egpi_step
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.numerics.kernel import kernel
from vo2_models.parameters import Value
from vo2_models.self_sensing.bounds import bound_table, table_at
from vo2_models.self_sensing.records import COMPOSITE
from vo2_models.self_sensing.scheme import SelfSensing

__all__ = ["CompositeSelfSensing", "searched_temperatures"]

Floats = NDArray[np.float64]

_MARGIN_K = 10.0
"""How far beyond the operating temperatures the inverse may search [K]: overshoot and a warmer ambient."""


@kernel
def composite_step(resistance, inverse, deflection, thermal, table, state):
    """One sample: (deflection [m], temperature [degC], surrogate [A], bound [m]).

    `inverse`, `deflection` : packed inverse of the resistance law and packed deflection law;
    `thermal` : ambient [degC], gain [K/A], gain [K/A^2]; `table` : bounds over log10 R;
    `state` : memories of the two laws one after the other, updated in place.
    """
    y = -math.log10(resistance)
    split = state.size - int(deflection[0]) - 1
    temperature = invert_update(y, inverse, state[:split])
    tip = egpi_step(temperature, deflection, state[split:])
    rise = temperature - thermal[0]
    surrogate = math.sqrt(max(rise, 0.0) / thermal[2]) if thermal[2] != 0.0 else rise / thermal[1]
    return tip, temperature, surrogate, table_at(table, -y)


def searched_temperatures(device: str) -> tuple[float, float]:
    """Return the lowest and highest temperature [degC] that the inverse of a resistance law searches on a device.

    Parameters
    ----------
    device : see `preset`
    """
    nominal = preset(device)
    ends = sorted(nominal.steady_temperature(i) for i in nominal.operating_range)
    return min(ends[0] - _MARGIN_K, nominal.ambient - _MARGIN_K), ends[1] + _MARGIN_K


@dataclass(frozen=True, eq=False)
class CompositeSelfSensing(SelfSensing):
    """Inverse resistance law, then deflection law.

    Parameters
    ----------
    device : preset id; it fixes the temperature scale and the range the inverse searches
    resistance : law of y = -log10(R / ohm) over the temperature in degC
    deflection : law of the tip deflection [m] over the temperature in degC
    table : [knots..., bounds...] over log10 R, from `bounds`

    Raises
    ------
    ValueError : an unknown device, or a resistance law that does not change over the temperatures in use.
    """

    kind = "composite"

    device: str
    resistance: EGPI
    deflection: EGPI
    table: Floats = field(default_factory=lambda: np.array([0.0, np.nan]), repr=False)
    _inverse: RobustInverse = field(init=False, repr=False)
    _thermal: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        nominal, limits = preset(self.device), searched_temperatures(self.device)
        thermal = np.array([nominal.ambient, nominal.linear_gain, nominal.square_gain])
        object.__setattr__(self, "_inverse", RobustInverse(self.resistance, limits))
        object.__setattr__(self, "_thermal", thermal)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> CompositeSelfSensing:
        resistance, deflection = (
            own
            if (own := PlayBank.from_parameters(f"{COMPOSITE}.{law}", parameters)).present
            else PlayBank.from_parameters(f"model.{law}", parameters)
            for law in ("resistance", "deflection")
        )
        for bank, what in ((resistance, "model.resistance"), (deflection, "model.deflection")):
            if not bank.present:
                raise ValueError(
                    f"{what}: found no law, the composite scheme needs one; load a model file that `fit` or "
                    "`identifier` wrote from a recording with resistance and deflection"
                )
        table = bound_table(cls.kind, parameters)
        return cls(str(parameters.get("model.device", "")), resistance.egpi(), deflection.egpi(), table)

    @property
    def temperature_range(self) -> tuple[float, float]:
        """Temperatures [degC] the inverse searches."""
        return cast("tuple[float, float]", self._inverse.input_range)  # the inverse has taken the model's

    def initial_state(self) -> Floats:
        low = self.temperature_range[0]
        return np.concatenate([model.initial_state(v=low) for model in (self.resistance, self.deflection)])

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        return composite_step(
            resistance, self._inverse.packed, self.deflection.packed, self._thermal, self.table, state
        )
