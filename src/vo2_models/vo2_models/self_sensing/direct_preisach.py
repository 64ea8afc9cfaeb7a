"""Direct Preisach self-sensing, section 7.3.1: a monotone Preisach operator and a memoryless part.

As the direct EGPI scheme, its loops are nested; the density is found by non-negative least squares. The loop of
deflection against resistance is far narrower than the range of resistances: a uniform grid of level 6 to 10 has
cells wider than the loop and is no better than a polynomial. So the walls stand between a uniform grid and one with
equally many samples of the identification between them, fine where the resistance changes slowly; the time of an
estimate does not depend on the level.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.hysteresis.preisach.grid import cell_areas, cell_count, pack
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.parameters import Value
from vo2_models.self_sensing.bounds import bound_table, table_at
from vo2_models.self_sensing.polynomial import polynomial_step
from vo2_models.self_sensing.records import SECTION
from vo2_models.self_sensing.scaled import COLD, HOT, domain_of, scaled, scaled_one
from vo2_models.self_sensing.scheme import SelfSensing, no_law
from vo2_models.validation import finite_array, increasing

__all__ = ["DirectPreisachSelfSensing", "walls_of"]

Floats = NDArray[np.float64]

_RIDGE = 1e-5
"""Weight of the size of the densities against the residual, relative: it settles what the recording left open."""
_QUANTILES, _EVEN_FROM = 0.65, 14.0
"""Share of equally many samples in the spacing of the walls, the rest even: the first number up to level 21, then
the second over the level, as a fine grid needs it less. Chosen on simulated devices of seeds 900000 to 900007."""


def walls_of(inputs: Floats, level: int) -> Floats:
    """Return (L + 1,) walls from COLD to HOT, between even spacing and quantiles of the inputs (n,).

    Parameters
    ----------
    level : L, number of cells along one axis
    """
    share = np.linspace(0.0, 1.0, level + 1)
    even = COLD + (HOT - COLD) * share
    part = min(_QUANTILES, _EVEN_FROM / level)
    return (1.0 - part) * even + part * np.quantile(inputs, share)


@dataclass(frozen=True, eq=False)
class DirectPreisachSelfSensing(SelfSensing):
    """Deflection [m] as a Preisach operator of the scaled -log10 of the resistance, plus a polynomial of it.

    Parameters
    ----------
    domain : (2,) lowest and highest log10 of the resistance in ohm of the identification
    weights : (L (L + 1) / 2,) packed integrals of the density over the cells [m]
    coefficients : (degree + 1,) Chebyshev coefficients of the memoryless part over log10 R [m]
    table : [knots..., bounds...] over log10 R, from `bounds`
    walls : (L + 1,) increasing walls of the cells over `scaled` resistance; None for a uniform grid
    """

    kind = "preisach"

    domain: Floats
    weights: Floats
    coefficients: Floats
    table: Floats = field(default_factory=lambda: np.array([0.0, np.nan]), repr=False)
    walls: Floats | None = None
    _operator: PreisachOperator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        domain = increasing(finite_array(self.domain, "domain", size=2), "domain")
        weights = finite_array(self.weights, "weights")
        level = round((math.sqrt(8 * weights.size + 1) - 1) / 2)
        if level < 1 or cell_count(level) != weights.size:
            raise ValueError(f"weights: found {weights.size}, need L (L + 1) / 2 cells for some level L")
        walls = np.linspace(COLD, HOT, level + 1)
        if self.walls is not None:
            walls = increasing(finite_array(self.walls, "walls", size=level + 1), "walls")
        object.__setattr__(self, "domain", domain)
        object.__setattr__(self, "walls", walls)
        object.__setattr__(self, "_operator", PreisachOperator.from_weights(walls, weights))

    @classmethod
    def fit(
        cls, resistance: ArrayLike, deflection: ArrayLike, level: int = 40, degree: int = 4
    ) -> DirectPreisachSelfSensing:
        """Fit to samples (n,) in order of time, of resistance [ohm] and deflection [m], from a cold rest.

        Raises
        ------
        ValueError : a resistance that does not change.
        """
        # loads scipy's linear algebra, which a node does not need
        from vo2_models.hysteresis.preisach.nnls import nonnegative_least_squares

        x = np.log10(finite_array(resistance, "resistance"))
        y = finite_array(deflection, "deflection", size=x.size)
        domain = domain_of(x)
        u = scaled(x, domain)
        walls = walls_of(u, level)
        cells = cell_count(level)
        area = signed_area_matrix(u, walls, bias=False)
        covered = np.ptp(walls) ** 2 / level**2
        basis = np.polynomial.chebyshev.chebvander((2 * x - domain.sum()) / np.diff(domain), degree)
        scale = max(float(np.ptp(y)), 1e-300)
        matrix = np.hstack([area / covered, basis])
        small = np.sqrt(_RIDGE * x.size) * np.eye(cells, cells + degree + 1)
        outputs = np.concatenate([y / scale, np.zeros(cells)])
        free = np.arange(cells + degree + 1) >= cells
        found = scale * nonnegative_least_squares(np.vstack([matrix, small]), outputs, free)
        return cls(domain, found[:cells] * pack(cell_areas(walls)) / covered, found[cells:], walls=walls)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> DirectPreisachSelfSensing:
        head = f"{SECTION}.preisach"
        if not parameters.get(f"{head}.weights"):
            raise no_law(head, parameters)
        names = ("domain", "weights", "coefficients")
        domain, weights, coefficients = (np.asarray(parameters[f"{head}.{name}"], float) for name in names)
        walls = np.asarray(parameters.get(f"{head}.walls", []), float)
        table = bound_table(cls.kind, parameters)
        return cls(domain, weights, coefficients, table, walls if walls.size else None)

    def to_parameters(self) -> dict[str, Value]:
        """Return the flat `model.self_sensing.preisach.*` parameters."""
        names = ("domain", "walls", "weights", "coefficients")
        return {f"{SECTION}.preisach.{name}": getattr(self, name).tolist() for name in names}

    def initial_state(self) -> Floats:
        return self._operator.initial_memory()

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        smooth = polynomial_step(resistance, self.domain, self.coefficients, self.table)[0]
        hysteretic = self._operator.step(scaled_one(resistance, self.domain), state)
        return smooth + hysteretic, math.nan, math.nan, table_at(self.table, math.log10(resistance))
