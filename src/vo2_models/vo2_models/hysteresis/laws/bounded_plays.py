"""Prandtl and Ishlinskii's law between two ends of the input, with an input that bends: a law of piezo stacks.

    y = sum_j p_j F_j[x^e] + polynomial(u),    x = (u - u_low) / (u_high - u_low) within 0 to 1,
    F_j[z] = max(z - r_j, min(z + r_j, F_j before)),    F_j = r_j at the lower end,

the classical play (B.3), (B.4) with one envelope z = x^e in both directions (B.6). Its slope after a turn is the same wherever
the input turns (for e = 1), so that few turns tell all loops. At the lower end each play stands where an input that came from
above has left it, which is where a stack rests between recordings; beyond the ends nothing moves.

    packed = [n, u_low, u_high, e, weights (n), radii (n)]
    memory = [u, F_1 ... F_n]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import Law, Saturation, side_of
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array, nonnegative, positive_number

__all__ = ["FORMS", "BoundedFit", "BoundedPlays", "fit_bounded_plays", "move_bounded_plays"]

Floats = NDArray[np.float64]

HEADER = 4
_RADII = 0.5 * (np.arange(24) / 24.0) ** 1.5
"""Radii of the plays that are fitted, closer where loops are small; one above a half of the range never moves back."""
FORMS = tuple((exponent, degree) for exponent in (1.0, 0.5, 2.0) for degree in (1, 3))
"""Exponents of the input and degrees of the memoryless part that are tried."""
_BEYOND = 0.25
"""How far the plays go on above the inputs of a fit, as a share of their range."""
_RIDGE = 1e-8
"""Of the mean power of the plays: far below any noise."""
_SAMPLES, _FOLDS, _SIMPLER = 4000, 5, 0.98
"""Samples that are fitted, parts held out in turn, and the share of the held-out error of what is simpler to be taken."""


@kernel
def move_bounded_plays(u, packed, memory, make):
    """Compiled step of the law, see `hysteresis.law`."""
    n = int(packed[0])
    x = min(max((u - packed[1]) / (packed[2] - packed[1]), 0.0), 1.0)
    z = x if packed[3] == 1.0 else x ** packed[3]
    total = 0.0
    for j in range(n):
        radius = packed[HEADER + n + j]
        level = max(z - radius, min(z + radius, memory[1 + j]))
        if make:
            memory[1 + j] = level
        total += packed[HEADER + j] * level
    if make:
        memory[0] = u
    return total


@kernel
def sweep_bounded_plays(u, packed, memory, out):
    """`move_bounded_plays` along the inputs u (n,)."""
    for k in range(u.size):
        out[k] = move_bounded_plays(u[k], packed, memory, True)


@kernel
def _play(u, packed, out):
    """Output (n,) of the single play of a packed law, of weight 1, along u (n,) from the lower end on."""
    memory = np.array([u[0], packed[HEADER + 1]])
    for k in range(u.size):
        out[k] = move_bounded_plays(u[k], packed, memory, True)


@dataclass(frozen=True, eq=False)
class BoundedPlays(Law):
    """Classical plays between two ends of the input, see the module.

    Parameters
    ----------
    weights : (n,) p, of plays that run over a range of 1 [output unit]
    radii : (n,) r >= 0 [1]
    low, high : u_low and u_high [input unit]
    exponent : e above 0 [1]
    polynomial : coefficients of 1, u, u^2 ... of the memoryless part [output unit]

    Raises
    ------
    ValueError : sizes that differ, a radius below 0, an exponent that is not above 0, or ends in the wrong order.

    Examples
    --------
    >>> law = BoundedPlays([1.0], [0.1], 20.0, 100.0)
    >>> law.run([20.0, 60.0, 100.0, 60.0, 20.0]).round(3).tolist()
    [0.1, 0.4, 0.9, 0.6, 0.1]
    """

    name = "bounded_plays"
    move = staticmethod(move_bounded_plays)
    sweep = staticmethod(sweep_bounded_plays)
    described: ClassVar = {
        "weights": ("{y}", "weights of the plays"),
        "radii": ("1", "play radii"),
        "low": ("{u}", "input at which every play stands at its lower end"),
        "high": ("{u}", "input at which every play stands at its upper end"),
        "exponent": ("1", "power of the input that the plays follow"),
        "polynomial": ("{y}", "coefficients of the powers of the input, lowest first,"),
    }

    weights: ArrayLike
    radii: ArrayLike
    low: float
    high: float
    exponent: float = 1.0
    polynomial: ArrayLike = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", finite_array(self.weights, "weights"))
        radii = nonnegative(finite_array(self.radii, "radii", size=np.size(self.weights)), "radii")
        object.__setattr__(self, "radii", radii)
        for name in ("low", "high"):
            object.__setattr__(self, name, float(finite_array(getattr(self, name), name, ndim=0)))
        if not self.low < self.high:
            raise ValueError(f"high: found {self.high:g}, need one above low, {self.low:g}")
        object.__setattr__(self, "exponent", positive_number(self.exponent, "exponent"))
        object.__setattr__(self, "polynomial", finite_array(self.polynomial, "polynomial"))

    @cached_property
    def packed(self) -> Floats:
        """The parameters as `move` takes them."""
        header = np.array([np.size(self.weights), self.low, self.high, self.exponent])
        return np.concatenate([header, self.weights, self.radii])

    @property
    def memory_size(self) -> int:
        """Length of the memory: present input and the outputs of the plays."""
        return 1 + np.size(self.weights)

    @property
    def span(self) -> tuple[float, float]:
        """Weighted sum of the plays at both ends of the input."""
        low, high = (self.initial_memory(side)[1:] for side in ("lower", "upper"))
        return float(np.dot(self.weights, low)), float(np.dot(self.weights, high))

    def initial_memory(self, saturation: Saturation = "lower") -> Floats:
        """Return the memory (memory_size,) at or beyond an end of the input, come from the other."""
        radii = np.asarray(self.radii)
        lower = side_of(saturation) < 0.0
        return np.concatenate([[-math.inf if lower else math.inf], radii if lower else 1.0 - radii])


@dataclass(frozen=True)
class BoundedFit:
    """A fitted law.

    Attributes
    ----------
    law : fitted to all measured samples
    error : root mean square of the residual on parts that were held out
    form : exponent of the input, and degree of the memoryless part
    """

    law: BoundedPlays
    error: float
    form: tuple[float, int]


def fit_bounded_plays(
    u: Floats,
    y: Floats,
    label: NDArray[np.int64],
    measured: NDArray[np.bool_],
    *,
    through: Callable[[Floats], Floats] | None = None,
    forms: Sequence[tuple[float, int]] = FORMS,
) -> BoundedFit:
    """Return the fit with weights that are not negative; exponent and memoryless part are what predicts held-out parts best.

    Parameters
    ----------
    u, y : (n,) input, from the lower end on, and output, which rises with it
    label : (n,) part of each sample; samples of one are held out together
    measured : (n,) whether a sample's output is used
    through : linear, what becomes of a column (n, 1) behind the law on the way to y
    forms : exponents and degrees that are tried, the simplest first

    Raises
    ------
    ValueError : fewer measured samples than twice the parts that are held out.
    """
    # loads slowly, and a node starts without it
    from vo2_models.hysteresis.fitting_kernels import without_closed_loops
    from vo2_models.identification.play_dictionary import nonnegative_weights

    low = float(u.min())
    high = low + (1.0 + _BEYOND) * float(np.ptp(u))
    rows = np.flatnonzero(measured)
    if rows.size < 2 * _FOLDS:
        raise ValueError(f"measured: found {rows.size} samples, need {2 * _FOLDS} for {BoundedPlays.name}")
    rows = rows[np.unique(np.linspace(0, rows.size - 1, min(rows.size, _SAMPLES)).astype(int))]
    part = np.unique(label[rows], return_inverse=True)[1] % _FOLDS
    if np.unique(part).size < _FOLDS:
        part = np.arange(rows.size) * 10 * _FOLDS // rows.size % _FOLDS
    target, path, at = y[rows], u, rows
    if through is None:  # a play at the rows is decided by few samples
        needed = np.zeros(u.size, dtype=np.bool_)
        needed[rows] = True
        few = without_closed_loops(u, needed)
        path, at = u[few], np.searchsorted(few, rows)
    x, out = (path - low) / (high - low), np.empty(path.size)

    def arrived(column: Floats) -> Floats:
        return through(column[:, None])[rows, 0] if through else column[at]

    def outputs(exponent: float) -> Floats:
        plays = np.empty((rows.size, _RADII.size))
        for j, radius in enumerate(_RADII):
            _play(path, np.array([1.0, low, high, exponent, 1.0, radius]), out)
            plays[:, j] = arrived(out)
        return plays

    centre = float(np.mean(target))

    def solved(columns: Floats, of: NDArray[np.bool_]) -> Floats:
        """Weights of the plays and coefficients of the powers behind them, from some of the samples."""
        normal = columns[of].T @ columns[of]
        plays = np.diag_indices(_RADII.size)
        normal[plays] += _RIDGE * np.mean(np.diag(normal)[: _RADII.size])
        return nonnegative_weights(normal, columns[of].T @ (target[of] - centre), _RADII.size)

    def error(columns: Floats) -> float:
        squares = 0.0
        for k in range(_FOLDS):
            held = part == k
            squares += float(np.sum((target - centre - columns @ solved(columns, ~held))[held] ** 2))
        return math.sqrt(squares / rows.size)

    powers = np.column_stack([arrived(x**k) for k in range(max(degree for _, degree in forms) + 1)])
    plays = {exponent: outputs(exponent) for exponent in dict.fromkeys(exponent for exponent, _ in forms)}
    form, least = forms[0], math.inf
    for exponent, degree in forms:
        found = error(np.hstack([plays[exponent], powers[:, : degree + 1]]))
        if found < _SIMPLER * least:
            form, least = (exponent, degree), found
    exponent, degree = form
    columns = np.hstack([plays[exponent], powers[:, : degree + 1]])
    weights, shares = np.split(solved(columns, np.ones(rows.size, dtype=np.bool_)), [_RADII.size])
    shares[0] += centre
    line = np.polynomial.Polynomial([-low / (high - low), 1.0 / (high - low)])
    polynomial = np.polynomial.Polynomial(shares)(line).coef
    kept = weights > 0.0
    return BoundedFit(BoundedPlays(weights[kept], _RADII[kept], low, high, exponent, polynomial), least, form)


EXAMPLE = BoundedPlays([0.4, 0.8], [0.0, 0.1], 30.0, 90.0, 1.0, [4.0, 0.01])


def _law(u: Floats, y: Floats, label: NDArray[np.int64], measured: NDArray[np.bool_]) -> BoundedPlays:
    return fit_bounded_plays(u, y, label, measured).law


FIT = _law
