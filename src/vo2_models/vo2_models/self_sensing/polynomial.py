"""Polynomial self-sensing: deflection as one polynomial of log10 R, sections 7.3.1 and 8.2.

Knows no history, so half the width of the deflection-resistance loop is its error; it is the yardstick
the other schemes are measured against. Chebyshev basis, for a well-conditioned fit of high degree.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.numerics.kernel import kernel
from vo2_models.parameters import Value
from vo2_models.self_sensing.bounds import bound_table, table_at
from vo2_models.self_sensing.records import SECTION
from vo2_models.self_sensing.scheme import SelfSensing, no_law
from vo2_models.validation import finite_array, increasing

__all__ = ["PolynomialSelfSensing"]

Floats = NDArray[np.float64]


@kernel
def polynomial_step(resistance, domain, coefficients, table):
    """(deflection [m], NaN, NaN, bound [m]) by Clenshaw's recurrence; held constant outside the domain."""
    x = math.log10(resistance)
    u = (2.0 * x - domain[0] - domain[1]) / (domain[1] - domain[0])
    u = min(max(u, -1.0), 1.0)
    high, higher = 0.0, 0.0
    for k in range(coefficients.size - 1, 0, -1):
        high, higher = 2.0 * u * high - higher + coefficients[k], high
    return u * high - higher + coefficients[0], math.nan, math.nan, table_at(table, x)


@dataclass(frozen=True, eq=False)
class PolynomialSelfSensing(SelfSensing):
    """Deflection [m] as a Chebyshev series of log10(R / ohm).

    Parameters
    ----------
    domain : (2,) lowest and highest log10 of the resistance in ohm; beyond them the value at the end holds
    coefficients : (degree + 1,) [m]
    table : [knots..., bounds...] over log10 R, from `bounds`

    Examples
    --------
    >>> line = PolynomialSelfSensing.fit([1e3, 1e4, 1e5], [3e-6, 2e-6, 1e-6], degree=1)
    >>> round(1e6 * line.update(1e4, line.initial_state()).deflection, 6)
    2.0
    """

    kind = "polynomial"

    domain: Floats
    coefficients: Floats
    table: Floats = field(default_factory=lambda: np.array([0.0, np.nan]), repr=False)

    def __post_init__(self) -> None:
        domain = increasing(finite_array(self.domain, "domain", size=2), "domain")
        object.__setattr__(self, "domain", domain)
        coefficients = finite_array(self.coefficients, "coefficients")
        if coefficients.size == 0:
            raise ValueError("coefficients: found none, need at least one")
        object.__setattr__(self, "coefficients", coefficients)

    @classmethod
    def fit(cls, resistance: ArrayLike, deflection: ArrayLike, degree: int = 8) -> PolynomialSelfSensing:
        """Least squares over samples (n,) of resistance [ohm] and deflection [m].

        Raises
        ------
        ValueError : fewer samples than coefficients, or a resistance that does not change.
        """
        x = np.log10(finite_array(resistance, "resistance"))
        y = finite_array(deflection, "deflection", size=x.size)
        if x.size <= degree:
            raise ValueError(f"resistance: found {x.size} sample(s), need more than the degree {degree}")
        if np.ptp(x) == 0:
            raise ValueError("resistance: found one value throughout, need a recording in which it changes")
        series = np.polynomial.Chebyshev.fit(x, y, degree)
        return cls(np.asarray(series.domain, float), np.asarray(series.coef, float))

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> PolynomialSelfSensing:
        section = f"{SECTION}.polynomial"
        domain, coefficients = parameters.get(f"{section}.domain"), parameters.get(f"{section}.coefficients")
        if not domain or not coefficients:
            raise no_law(section, parameters)
        return cls(
            np.asarray(domain, float), np.asarray(coefficients, float), bound_table(cls.kind, parameters)
        )

    def to_parameters(self) -> dict[str, Value]:
        """Return the flat `model.self_sensing.polynomial.*` parameters."""
        section = f"{SECTION}.polynomial"
        return {
            f"{section}.domain": self.domain.tolist(),
            f"{section}.coefficients": self.coefficients.tolist(),
        }

    def initial_state(self) -> Floats:
        return np.zeros(0)

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        return polynomial_step(resistance, self.domain, self.coefficients, self.table)
