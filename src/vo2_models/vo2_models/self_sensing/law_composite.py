"""The composite scheme with any law of the registry: inverse of the resistance law by bisection, then deflection law.

It is what `composite` stands for where a model's laws are no banks of plays and its file has no laws of the scheme's own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import surrogate_of_temperature
from vo2_models.device.description import preset
from vo2_models.hysteresis.law import Inverse, Law
from vo2_models.hysteresis.laws import law_from_parameters
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.parameters import Value
from vo2_models.self_sensing.bounds import bound_table, table_at
from vo2_models.self_sensing.composite import searched_temperatures
from vo2_models.self_sensing.records import COMPOSITE
from vo2_models.self_sensing.scheme import SelfSensing

__all__ = ["LawComposite"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LawComposite(SelfSensing):
    """Inverse resistance law, then deflection law.

    Parameters
    ----------
    device : preset id or device file; it fixes the temperature scale
    resistance, deflection : laws of y = -log10(R / ohm) and of the tip deflection [m] over the temperature [degC]
    limits : temperatures that the inverse searches [degC]
    table : [knots..., bounds...] over log10 R, from `bounds`

    Raises
    ------
    ValueError : a resistance law without an inverse, as its output does not rise with the temperature.
    """

    kind = "composite"

    device: str
    resistance: Law
    deflection: Law
    limits: tuple[float, float]
    table: Floats = field(default_factory=lambda: np.array([0.0, np.nan]), repr=False)
    _inverse: Inverse = field(init=False, repr=False)

    def __post_init__(self) -> None:
        path = np.linspace(*self.limits, 400)
        memory = self.resistance.settle(self.limits[0])
        rise = np.diff(self.resistance.run(path, memory))
        if not rise.sum() > 0.0 or rise.min() < -1e-6 * rise.sum():
            over = "temperature" if preset(self.device).has_body else "loop coordinate (30 to 90)"
            raise ValueError(
                f"model.resistance.law: found {self.resistance.name!r} whose -log10 R falls while the {over} rises through "
                f"{path[int(np.argmin(rise))]:.4g}, need a law with an inverse: `fit --law plays` writes one"
            )
        object.__setattr__(self, "_inverse", self.resistance.inverse(self.limits))

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> LawComposite:
        device = str(parameters.get("model.device", ""))
        laws = [law_from_parameters(f"model.{name}", parameters) for name in ("resistance", "deflection")]
        return cls(device, laws[0], laws[1], searched_temperatures(device), bound_table(cls.kind, parameters))

    @staticmethod
    def serves(parameters: Mapping[str, Value]) -> bool:
        """Whether the model has both laws, not both banks of plays, and none for the scheme `composite` alone."""
        own = PlayBank.from_parameters(f"{COMPOSITE}.resistance", parameters).present
        laws = [law_from_parameters(f"model.{name}", parameters) for name in ("resistance", "deflection")]
        plays = all(isinstance(law, PlayBank) for law in laws)
        return not own and not plays and all(law.present for law in laws)

    def initial_state(self) -> Floats:
        return np.concatenate([law.settle(self.limits[0]) for law in (self.resistance, self.deflection)])

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        split = self.resistance.memory_size
        y = -math.log10(resistance)
        temperature = self._inverse.invert(y, state[:split]).input
        tip = self.deflection.step(temperature, state[split:])
        surrogate = float(surrogate_of_temperature(self.device, np.array(temperature)))
        return tip, temperature, surrogate, float(table_at(self.table, -y))
