"""The comparison model without memory: a single-valued polynomial, sections 5.3.2 and 5.4.2."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray
from vo2_models.validation import finite_array

__all__ = ["PolynomialModel", "fit_polynomial"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PolynomialModel:
    """u = p(v), whatever came before.

    Attributes
    ----------
    polynomial : in the scaled variable of numpy's `Polynomial`
    """

    polynomial: Polynomial

    def __call__(self, v: ArrayLike) -> Floats:
        """Return the output under `v`, any shape."""
        return np.asarray(self.polynomial(np.asarray(v, dtype=np.float64)), dtype=np.float64)

    def inverse(self, u: ArrayLike, points: int = 4001) -> Floats:
        """Return for each output the input whose modelled output is nearest, from a look-up table (5.4.2)."""
        v = np.linspace(self.polynomial.domain[0], self.polynomial.domain[1], points)
        table = self(v)
        order = np.argsort(table)
        ranked = table[order]
        wanted = finite_array(u, "u", ndim=None)
        place = np.clip(np.searchsorted(ranked, wanted), 1, points - 1)
        place -= wanted - ranked[place - 1] < ranked[place] - wanted
        return np.asarray(v[order][place], dtype=np.float64)


def fit_polynomial(v: ArrayLike, u: ArrayLike, degree: int = 12) -> PolynomialModel:
    """Least squares polynomial; the degree of section 5.3.2 is 12.

    Parameters
    ----------
    v, u : (n,) inputs and outputs
    degree : of the polynomial

    Returns
    -------
    PolynomialModel : without memory

    Raises
    ------
    ValueError : not finite, shapes differ, or not more distinct inputs than the degree.

    Examples
    --------
    >>> v = np.linspace(0.0, 2.0, 50)
    >>> model = fit_polynomial(v, v**3, degree=3)
    >>> round(float(model(1.5)), 6), round(float(model.inverse(3.375)), 3)
    (3.375, 1.5)
    """
    inputs = finite_array(v, "v")
    outputs = finite_array(u, "u", size=inputs.size)
    distinct = np.unique(inputs).size
    if degree < 0 or distinct <= degree:
        raise ValueError(
            f"v: found {distinct} distinct input(s), need more than the degree {degree}, which must be >= 0"
        )
    return PolynomialModel(Polynomial.fit(inputs, outputs, degree))
