"""Direct EGPI self-sensing, section 7.3.1: one extended play model between resistance and deflection.

Cheaper than the composite scheme and less exact: its loops of deflection against resistance are nested, those of
a device whose two transitions do not coincide are not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis import EGPI
from vo2_models.hysteresis.kernels import egpi_step
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import fit_bank, starting_shape
from vo2_models.numerics.kernel import kernel
from vo2_models.parameters import Value
from vo2_models.self_sensing.bounds import bound_table, table_at
from vo2_models.self_sensing.records import SECTION
from vo2_models.self_sensing.scaled import COLD, domain_of, scaled, scaled_one
from vo2_models.self_sensing.scheme import SelfSensing, no_law
from vo2_models.validation import finite_array, increasing

__all__ = ["DirectEGPISelfSensing"]

Floats = NDArray[np.float64]


@kernel
def direct_egpi_step(resistance, domain, packed, table, state):
    """(deflection [m], NaN, NaN, bound [m]); `state` is updated in place."""
    tip = egpi_step(scaled_one(resistance, domain), packed, state)
    return tip, math.nan, math.nan, table_at(table, math.log10(resistance))


@dataclass(frozen=True, eq=False)
class DirectEGPISelfSensing(SelfSensing):
    """Deflection [m] as an EGPI model of the scaled -log10 of the resistance.

    Parameters
    ----------
    domain : (2,) lowest and highest log10 of the resistance in ohm of the identification
    bank : plays and polynomial over `scaled` resistance
    table : [knots..., bounds...] over log10 R, from `bounds`
    """

    kind = "egpi"

    domain: Floats
    bank: PlayBank
    table: Floats = field(default_factory=lambda: np.array([0.0, np.nan]), repr=False)
    _law: EGPI = field(init=False, repr=False)

    def __post_init__(self) -> None:
        domain = increasing(finite_array(self.domain, "domain", size=2), "domain")
        object.__setattr__(self, "domain", domain)
        object.__setattr__(self, "_law", self.bank.egpi())

    @classmethod
    def fit(cls, resistance: ArrayLike, deflection: ArrayLike, plays: int = 6) -> DirectEGPISelfSensing:
        """Fit to samples (n,) in order of time, of resistance [ohm] and deflection [m], from a cold rest.

        Raises
        ------
        ValueError : a resistance that does not change, or fewer samples than the fit needs.
        """
        x = np.log10(finite_array(resistance, "resistance"))
        y = finite_array(deflection, "deflection", size=x.size)
        domain = domain_of(x)
        u = scaled(x, domain)
        found = fit_bank(u, y, starting_shape(u, y, plays=plays))
        return cls(domain, found.shape.bank())

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> DirectEGPISelfSensing:
        bank = PlayBank.from_parameters(f"{SECTION}.egpi", parameters)
        if not bank.present:
            raise no_law(f"{SECTION}.egpi", parameters)
        return cls(
            np.asarray(parameters[f"{SECTION}.egpi.domain"], float), bank, bound_table(cls.kind, parameters)
        )

    def to_parameters(self) -> dict[str, Value]:
        """Return the flat `model.self_sensing.egpi.*` parameters."""
        return {f"{SECTION}.egpi.domain": self.domain.tolist(), **self.bank.to_parameters(f"{SECTION}.egpi")}

    def initial_state(self) -> Floats:
        return self._law.initial_state(v=COLD)

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        return direct_egpi_step(resistance, self.domain, self._law.packed, self.table, state)
