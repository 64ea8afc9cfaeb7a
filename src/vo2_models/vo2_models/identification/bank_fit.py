"""Fit of a play bank and polynomial to one channel over a known temperature.

Levenberg-Marquardt on all shapes and weights at once, with exact derivatives. Slopes, half widths and
weights are fitted as logarithms, so they stay positive and the envelopes cannot cross.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.levenberg_marquardt import levenberg_marquardt
from vo2_models.identification.sensitivity import play_sensitivities

__all__ = [
    "BankFit",
    "BankShape",
    "Late",
    "ShapeRules",
    "evaluate",
    "fit_bank",
    "shape_rules",
    "starting_shape",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Late:
    """What a response goes through behind its loops; linear, and 1 at rest.

    Attributes
    ----------
    through : what becomes of (n, k) columns, such as outputs of plays
    whole : whether the memoryless part goes the same way
    """

    through: Callable[[Floats], Floats]
    whole: bool = False

    def __call__(self, plays: Floats, powers: Floats) -> tuple[Floats, Floats]:
        """Return outputs of plays (n, k) and powers of the memoryless part (n, m) as they arrive."""
        return self.through(plays), self.through(powers) if self.whole else powers


# bounds of the shape parameters: slope [1/K], half width [K], weight relative to the channel's range
_SLOPE = (0.03, 5.0)
_WIDTH = (0.05, 30.0)
_WEIGHT = (1e-6, 3.0)
POLYNOMIAL_CENTRE = 60.0
POLYNOMIAL_SCALE = 30.0
"""The polynomial is fitted in (T - 60) / 30 and stored in powers of T."""


@dataclass(frozen=True)
class BankShape:
    """Parameters of a bank in fitting coordinates.

    Attributes
    ----------
    log_slope, centre, log_width, log_weight : (N,); centre in degC, weight in units of the channel
    polynomial : (m,) in powers of (T - 60) / 30
    """

    log_slope: Floats
    centre: Floats
    log_width: Floats
    log_weight: Floats
    polynomial: Floats

    @property
    def vector(self) -> Floats:
        """All parameters, (4 N + m,)."""
        return np.concatenate([self.log_slope, self.centre, self.log_width, self.log_weight, self.polynomial])

    @classmethod
    def of(cls, vector: Floats, plays: int) -> BankShape:
        """Return the shape that `vector` holds."""
        parts = [vector[k * plays : (k + 1) * plays] for k in range(4)]
        return cls(parts[0], parts[1], parts[2], parts[3], vector[4 * plays :])

    @classmethod
    def of_bank(cls, bank: Law) -> BankShape:
        """Return the fitting coordinates of a bank; raise a `ValueError` where it has none."""
        if not isinstance(bank, PlayBank):
            raise ValueError(f"bank: found the law {bank.name!r}, need a bank of plays")
        slope, falling = np.asarray(bank.rising_slopes), np.asarray(bank.falling_slopes)
        weights = np.asarray(bank.weights)
        if np.any(np.asarray(bank.radii) != 0.0) or not np.allclose(slope, falling) or np.any(weights <= 0.0):
            raise ValueError(
                "bank: found play radii, unequal slopes or weights <= 0, need a bank that a fit wrote"
            )
        rising = -np.asarray(bank.rising_offsets) / slope
        falling = -np.asarray(bank.falling_offsets) / slope
        line = np.polynomial.Polynomial([POLYNOMIAL_CENTRE, POLYNOMIAL_SCALE])
        powers = np.polynomial.Polynomial(np.asarray(bank.polynomial))(line)
        coefficients = np.zeros(np.size(bank.polynomial))
        coefficients[: powers.coef.size] = powers.coef
        return cls(
            log_slope=np.log(slope),
            centre=0.5 * (rising + falling),
            log_width=np.log(0.5 * (rising - falling)),
            log_weight=np.log(weights),
            polynomial=coefficients,
        )

    def bank(self) -> PlayBank:
        """Return the bank in the model file's parameters, widest play last."""
        order = np.argsort(self.log_width)
        slope = np.exp(self.log_slope)[order]
        centre, width = self.centre[order], np.exp(self.log_width)[order]
        powers = np.polynomial.Polynomial(self.polynomial)
        line = np.polynomial.Polynomial([-POLYNOMIAL_CENTRE / POLYNOMIAL_SCALE, 1.0 / POLYNOMIAL_SCALE])
        in_t = powers(line)
        coefficients = np.zeros(self.polynomial.size)
        coefficients[: in_t.coef.size] = in_t.coef
        return PlayBank(
            weights=np.exp(self.log_weight)[order],
            radii=np.zeros(slope.size),
            rising_slopes=slope,
            rising_offsets=-slope * (centre + width),
            falling_slopes=slope,
            falling_offsets=-slope * (centre - width),
            polynomial=coefficients,
        )


@dataclass(frozen=True)
class BankFit:
    """Result of a fit.

    Attributes
    ----------
    shape : parameters
    residual : (n,) measured minus model, NaN where not measured
    jacobian : (n, 4 N + m) derivatives of the model
    iterations : Levenberg-Marquardt steps taken
    """

    shape: BankShape
    residual: Floats = field(repr=False)
    jacobian: Floats = field(repr=False)
    iterations: int

    def residual_of(self, temperature: Floats, values: Floats, late: Late | None = None) -> Floats:
        """Return what the fitted shape leaves of other values (n,) along a temperature (n,), NaN where missing."""
        return values - evaluate(self.shape, temperature, late)[0]


def starting_shape(temperature: Floats, values: Floats, *, plays: int, degree: int = 3) -> BankShape:
    """Return a start from where the channel crosses the middle of its range on heating and on cooling.

    Parameters
    ----------
    temperature : (n,) [degC]
    values : (n,) [unit of the channel]
    plays : number of plays
    degree : of the polynomial
    """
    ok = np.isfinite(values)
    t, y = temperature[ok], values[ok]
    low, high = np.quantile(y, [0.02, 0.98])
    span = max(float(high - low), 1e-300)
    middle = 0.5 * (low + high)
    above = y > middle
    up = np.flatnonzero(~above[:-1] & above[1:])
    down = np.flatnonzero(above[:-1] & ~above[1:])
    heating = float(np.quantile(t[up + 1], 0.9)) if up.size else float(np.median(t)) + 3.0
    cooling = float(np.quantile(t[down + 1], 0.1)) if down.size else heating - 6.0
    width = max(0.5 * (heating - cooling), 0.5)
    spread = np.linspace(0.5 / plays, 1.0 - 0.5 / plays, plays)
    half = np.maximum(width * (1.0 + 0.3 * ndtri(spread)), 0.3)
    return BankShape(
        log_slope=np.full(plays, np.log(0.25)),
        centre=heating - half,
        log_width=np.log(half),
        log_weight=np.full(plays, np.log(0.5 * span / plays)),
        polynomial=np.concatenate([[middle], np.zeros(degree)]),
    )


@dataclass(frozen=True)
class ShapeRules:
    """Bounds, largest steps and prior precisions of the fitting coordinates, each (4 N + m,)."""

    lower: Floats
    upper: Floats
    largest: Floats
    prior: Floats


def shape_rules(plays: int, size: int, values: Floats) -> ShapeRules:
    """Return the rules for a bank of `plays` fitted to `values`.

    The prior lets a play move by a factor or a few kelvin at the price of a few samples of one per cent of
    range; it only keeps plays in place that the data say nothing about. The polynomial is free.

    Parameters
    ----------
    size : number of samples
    """
    span = max(float(np.nanmax(values) - np.nanmin(values)), 1e-300)
    prior, largest = np.zeros(size), np.full(size, np.inf)
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    for part, sigma in enumerate((1.0, 6.0, 1.0, 2.0)):
        prior[part * plays : (part + 1) * plays] = 2.0 * (0.01 * span / sigma) ** 2
        largest[part * plays : (part + 1) * plays] = 3.0
    for part, (low, high) in ((0, _SLOPE), (2, _WIDTH), (3, (_WEIGHT[0] * span, _WEIGHT[1] * span))):
        lower[part * plays : (part + 1) * plays] = np.log(low)
        upper[part * plays : (part + 1) * plays] = np.log(high)
    return ShapeRules(lower, upper, largest, prior)


def evaluate(shape: BankShape, temperature: Floats, late: Late | None = None) -> tuple[Floats, Floats]:
    """Return the model's output (n,) and its derivatives (n, 4 N + m) along a temperature (n,) [degC].

    Parameters
    ----------
    shape : in fitting coordinates
    late : what comes behind them
    """
    slope, width, weight = (np.exp(v) for v in (shape.log_slope, shape.log_width, shape.log_weight))
    plays = slope.size
    jacobian = np.empty((temperature.size, 4 * plays + shape.polynomial.size))
    play_sensitivities(temperature, slope, shape.centre, width, weight, jacobian)
    x = (temperature - POLYNOMIAL_CENTRE) / POLYNOMIAL_SCALE
    jacobian[:, 4 * plays :] = np.vander(x, shape.polynomial.size, increasing=True)
    if late:
        jacobian[:, : 4 * plays], jacobian[:, 4 * plays :] = late(
            jacobian[:, : 4 * plays], jacobian[:, 4 * plays :]
        )
    # a weighted play is its own derivative by the logarithm of its weight
    return jacobian[:, 3 * plays :] @ np.concatenate([np.ones(plays), shape.polynomial]), jacobian


def fit_bank(
    temperature: Floats,
    values: Floats,
    start: BankShape,
    *,
    iterations: int = 120,
    tolerance: float = 3e-5,
    late: Late | None = None,
) -> BankFit:
    """Fit a bank to `values` (n,) over `temperature` (n,) [degC] from a start.

    Parameters
    ----------
    temperature : the path from the device's cold rest on, without gaps
    values : measured values in path order, NaN where missing
    start : where to begin; also the centre of a weak prior that keeps unused plays where they are
    iterations : most steps
    tolerance : relative decrease of the squared residual at which the fit ends
    late : what comes behind the plays, see `evaluate`

    Returns
    -------
    BankFit : shape, residual and Jacobian

    Raises
    ------
    ValueError : fewer measured values than parameters.
    """
    ok = np.isfinite(values)
    theta = start.vector
    plays = start.centre.size
    if np.count_nonzero(ok) < 2 * theta.size:
        raise ValueError(f"values: found {np.count_nonzero(ok)} measured, need at least {2 * theta.size}")
    rules = shape_rules(plays, theta.size, values)

    def gap(vector: Floats) -> tuple[Floats, Callable[[], Floats]]:
        model, jacobian = evaluate(BankShape.of(vector, plays), temperature, late)
        return (model - values)[ok], lambda: jacobian[ok]

    found = levenberg_marquardt(
        gap,
        theta,
        lower=rules.lower,
        upper=rules.upper,
        largest_step=rules.largest,
        prior=rules.prior,
        steps=iterations,
        tolerance=tolerance,
    )
    shape = BankShape.of(found.theta, plays)
    model, jacobian = evaluate(shape, temperature, late)
    return BankFit(shape, values - model, jacobian, found.steps)
