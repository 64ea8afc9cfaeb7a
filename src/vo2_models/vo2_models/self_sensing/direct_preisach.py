"""Direct Preisach self-sensing, section 7.3.1: a monotone Preisach operator and a memoryless part.

As the direct EGPI scheme, its loops are nested; the density is found by non-negative least squares.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.parameters import Value
from vo2_models.preisach import PreisachOperator
from vo2_models.preisach.grid import cell_count
from vo2_models.preisach.memory import PreisachState
from vo2_models.preisach.nnls import nonnegative_least_squares
from vo2_models.preisach.signed_area import signed_area_matrix
from vo2_models.self_sensing.bounds import bound_table, table_at
from vo2_models.self_sensing.polynomial import polynomial_step
from vo2_models.self_sensing.records import SECTION
from vo2_models.self_sensing.scaled import COLD, HOT, domain_of, scaled, scaled_one
from vo2_models.self_sensing.scheme import SelfSensing
from vo2_models.validation import finite_array, increasing

__all__ = ["DirectPreisachSelfSensing"]

Floats = NDArray[np.float64]

_RIDGE = 1e-6
"""Weight of the size of the densities against the residual, relative: it settles what the recording left open."""
_TURNING_POINTS = 4096
"""Room for the memory; each needs 16 bytes. Noise of one level never nests so deep."""


@dataclass(frozen=True, eq=False)
class DirectPreisachSelfSensing(SelfSensing):
    """Deflection [m] as a Preisach operator of the scaled -log10 of the resistance, plus a polynomial of it.

    Parameters
    ----------
    domain : (2,) lowest and highest log10 of the resistance in ohm of the identification
    weights : (L (L + 1) / 2,) packed integrals of the density over the cells of a uniform grid [m]
    coefficients : (degree + 1,) Chebyshev coefficients of the memoryless part over log10 R [m]
    table : [knots..., bounds...] over log10 R, from `bounds`
    """

    kind = "preisach"

    domain: Floats
    weights: Floats
    coefficients: Floats
    table: Floats = field(default_factory=lambda: np.array([0.0, np.nan]), repr=False)
    _operator: PreisachOperator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        domain = increasing(finite_array(self.domain, "domain", size=2), "domain")
        weights = finite_array(self.weights, "weights")
        level = round((math.sqrt(8 * weights.size + 1) - 1) / 2)
        if level < 1 or cell_count(level) != weights.size:
            raise ValueError(f"weights: found {weights.size}, need L (L + 1) / 2 cells for some level L")
        walls = np.linspace(COLD, HOT, level + 1)
        object.__setattr__(self, "domain", domain)
        object.__setattr__(self, "_operator", PreisachOperator.from_weights(walls, weights))

    @classmethod
    def fit(
        cls, resistance: ArrayLike, deflection: ArrayLike, level: int = 20, degree: int = 4
    ) -> DirectPreisachSelfSensing:
        """Fit to samples (n,) in order of time, of resistance [ohm] and deflection [m], from a cold rest.

        Raises
        ------
        ValueError : a resistance that does not change.
        """
        x = np.log10(finite_array(resistance, "resistance"))
        y = finite_array(deflection, "deflection", size=x.size)
        domain = domain_of(x)
        walls = np.linspace(COLD, HOT, level + 1)
        cells = cell_count(level)
        area = signed_area_matrix(scaled(x, domain), walls, bias=False)
        covered = np.ptp(walls) ** 2 / level**2
        basis = np.polynomial.chebyshev.chebvander((2 * x - domain.sum()) / np.diff(domain), degree)
        scale = max(float(np.ptp(y)), 1e-300)
        matrix = np.hstack([area / covered, basis])
        small = np.sqrt(_RIDGE * x.size) * np.eye(cells, cells + degree + 1)
        outputs = np.concatenate([y / scale, np.zeros(cells)])
        free = np.arange(cells + degree + 1) >= cells
        found = scale * nonnegative_least_squares(np.vstack([matrix, small]), outputs, free)
        areas = np.full(cells, 1.0)
        areas[[i * (i + 1) // 2 + i for i in range(level)]] = 0.5
        return cls(domain, found[:cells] * areas, found[cells:])

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> DirectPreisachSelfSensing:
        head = f"{SECTION}.preisach"
        if not parameters.get(f"{head}.weights"):
            raise ValueError(
                f"{head}: found no law; load a model file that `fit` or `identifier` wrote from a recording with "
                "resistance and deflection"
            )
        names = ("domain", "weights", "coefficients")
        domain, weights, coefficients = (np.asarray(parameters[f"{head}.{name}"], float) for name in names)
        return cls(domain, weights, coefficients, bound_table(cls.kind, parameters))

    def to_parameters(self) -> dict[str, Value]:
        """Return the flat `model.self_sensing.preisach.*` parameters."""
        names = ("domain", "weights", "coefficients")
        return {f"{SECTION}.preisach.{name}": getattr(self, name).tolist() for name in names}

    def initial_state(self) -> Floats:
        first = self._operator.saturated().array
        state = np.zeros(first.size + 2 * _TURNING_POINTS)
        state[: first.size] = first
        return state

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        smooth = polynomial_step(resistance, self.domain, self.coefficients, self.table)[0]
        hysteretic = self._operator.update(scaled_one(resistance, self.domain), PreisachState(state))
        return smooth + hysteretic, math.nan, math.nan, table_at(self.table, math.log10(resistance))
