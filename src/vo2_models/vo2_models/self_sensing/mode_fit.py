"""Identification of a structural mode from a static deflection estimate and the measured deflection.

The model is that of the effect `cantilever_resonance`: measured = (1 - share) static + share z with
z'' + 2 zeta w z' + w^2 z = w^2 static, section 7.2.1's structural dynamics. A law that was fitted without the mode
has taken up some of its ringing, so the law is then fitted once more through the mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vo2_models.device.mode import mode_step
from vo2_models.identification.bank_fit import BankShape, evaluate, shape_rules
from vo2_models.identification.levenberg_marquardt import levenberg_marquardt
from vo2_models.numerics.kernel import kernel

__all__ = ["REMOVED", "ModeFit", "fit_law_through_mode", "fit_mode", "through_mode"]

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

REMOVED = 0.5
"""Share of the residual energy in the held-out half of the recording that a mode must remove to be accepted."""
BLOCKS = 8
"""The recording is cut into so many blocks; a mode is tried on the even ones and judged on the odd ones, so that both
halves hold every kind of excitation in it."""
DAMPINGS = (0.01, 0.05, 0.2)
"""Damping ratios of the grid; the refinement moves them."""
DAMPING_RANGE = (1e-3, 0.4)
"""Beyond it there is no ringing that could tell a mode from a lag or from the thermal time constant."""
FREQUENCY_STEP = 0.01
"""Relative spacing of the grid: the half-power width of the least damped mode on it is twice as much."""
HIGHEST = 0.95
"""Highest frequency, of Nyquist's."""
CYCLES = 8
"""The lowest frequency has this many periods in half the duration of the recording."""
SHORTEST = 128
"""Fewest samples in which a mode is looked for."""


@dataclass(frozen=True)
class ModeFit:
    """A structural mode.

    Attributes
    ----------
    frequency : undamped natural frequency [Hz]
    damping : ratio
    share : part of the deflection that moves through the mode, 0 to 1
    period : sample period it was identified at [s]
    removed : share of the residual energy it removes in the held-out half, fitted on the other
    """

    frequency: float
    damping: float
    share: float
    period: float
    removed: float


@kernel
def through_mode(columns, step, out):
    """Pass each column of (n, m) through the mode from rest at its first sample; `step` from `mode_step`.

    Parameters
    ----------
    columns : (n, m) inputs
    out : (n, m) filled with the outputs
    """
    for j in range(columns.shape[1]):
        last = columns[0, j]
        z, rate = last, 0.0
        for k in range(columns.shape[0]):
            new = columns[k, j]
            moved = step[0, 0] * z + step[0, 1] * rate + step[0, 2] * last + step[0, 3] * new
            rate = step[1, 0] * z + step[1, 1] * rate + step[1, 2] * last + step[1, 3] * new
            z, last = moved, new
            out[k, j] = z


@kernel
def grid_gain(static, residual, used, steps, gains):
    """Residual energy over the samples `used` that each step of (g, 2, 4) removes with its best share in [0, 1]."""
    for g in range(steps.shape[0]):
        step = steps[g]
        last = static[0]
        z, rate, power, product = last, 0.0, 0.0, 0.0
        for k in range(static.size):
            new = static[k]
            moved = step[0, 0] * z + step[0, 1] * rate + step[0, 2] * last + step[0, 3] * new
            rate = step[1, 0] * z + step[1, 1] * rate + step[1, 2] * last + step[1, 3] * new
            z, last = moved, new
            if used[k]:
                power += (z - new) * (z - new)
                product += (z - new) * residual[k]
        share = min(max(product / power, 0.0), 1.0) if power > 0.0 else 0.0
        gains[g] = share * (2.0 * product - share * power)


def _dynamic_part(static: Floats, frequency: float, damping: float, period: float) -> Floats:
    """What the mode adds to the static deflection (n,) at share 1 [m]."""
    out = np.empty((static.size, 1))
    through_mode(static[:, None], mode_step(frequency, damping, period), out)
    return np.asarray(out[:, 0] - static)


def _refined(
    static: Floats, residual: Floats, used: Flags, start: tuple[float, float, float], period: float
) -> Floats:
    """Return (log frequency, log damping, share) after least squares over the samples `used` from a start."""
    scale = float(np.sqrt(np.mean(residual[used] ** 2)))
    begin = np.array([math.log(start[0]), math.log(start[1]), min(max(start[2], 1e-3), 1.0)])
    lower = [begin[0] - 0.1, math.log(DAMPING_RANGE[0]), 0.0]
    upper = [min(begin[0] + 0.1, math.log(0.5 / period)), math.log(DAMPING_RANGE[1]), 1.0 + 1e-9]

    def gap(vector: Floats) -> Floats:
        part = _dynamic_part(static, math.exp(vector[0]), math.exp(vector[1]), period)
        return np.asarray((vector[2] * part - residual)[used] / scale)

    found = least_squares(gap, begin, bounds=(lower, upper), x_scale=[0.003, 0.3, 0.1], max_nfev=60)
    return np.asarray(found.x)


def fit_mode(static: Floats, measured: Floats, period: float) -> tuple[ModeFit | None, str]:
    """Find a mode between a static deflection estimate and the measured deflection.

    Parameters
    ----------
    static, measured : (n,) at every sample period, in order of time [m]
    period : [s]

    Returns
    -------
    The mode and an empty text, or None and the reason. A mode is accepted if, fitted on the even of `BLOCKS` blocks
    alone, it removes at least the share `REMOVED` of the residual energy in the odd ones; it is then fitted on all.
    """
    n = static.size
    if n < SHORTEST:
        return None, f"{n} samples are too few to find a mode, {SHORTEST} are needed"
    static = np.ascontiguousarray(static, dtype=np.float64)
    residual = np.ascontiguousarray(measured - static)
    even = (np.arange(n) * BLOCKS // n) % 2 == 0
    held = residual[~even]
    lowest, highest = 2 * CYCLES / (n * period), HIGHEST * 0.5 / period
    if not np.any(residual[even]) or not np.any(held) or np.ptp(static[even]) == 0.0:
        return None, "the recording leaves no dynamic residual"
    count = math.ceil(math.log(highest / lowest) / FREQUENCY_STEP)
    grid = [(f, zeta) for f in np.geomspace(lowest, highest, count) for zeta in DAMPINGS]
    steps = np.array([mode_step(f, zeta, period) for f, zeta in grid])
    gains = np.empty(len(grid))
    grid_gain(static, residual, even, steps, gains)
    if gains.max() <= 0.0:
        return None, "no mode reduces the residual of the recording"
    frequency, damping = grid[int(np.argmax(gains))]
    trial = _refined(static, residual, even, (float(frequency), damping, 0.8), period)
    part = _dynamic_part(static, math.exp(trial[0]), math.exp(trial[1]), period)[~even]
    removed = 1.0 - float(np.sum((held - trial[2] * part) ** 2) / np.sum(held**2))
    if removed < REMOVED:
        return None, (
            f"the best mode removes {100 * removed:.0f} % of the residual energy in the held-out half of the "
            f"recording, {100 * REMOVED:.0f} % are needed"
        )
    if trial[1] > math.log(0.99 * DAMPING_RANGE[1]):
        return None, "what the residual shows is not lightly damped"
    if not math.log(lowest) <= trial[0] <= math.log(highest):
        return None, f"the residual shows no mode between {lowest:.3g} and {highest:.3g} Hz"
    everywhere = np.ones(n, dtype=np.bool_)
    final = _refined(static, residual, everywhere, (math.exp(trial[0]), math.exp(trial[1]), trial[2]), period)
    share = min(float(final[2]), 1.0)
    return ModeFit(math.exp(final[0]), math.exp(final[1]), share, float(period), removed), ""


def fit_law_through_mode(
    temperature: Floats, measured: Floats, start: BankShape, mode: ModeFit, *, iterations: int = 40
) -> tuple[BankShape, ModeFit] | None:
    """Fit the deflection law and the mode together, so that the law need not imitate ringing.

    Parameters
    ----------
    temperature : (n,) that the inverse of the resistance law found [degC]
    measured : (n,) deflection [m]
    start, mode : where to begin
    iterations : most steps of the search

    Returns
    -------
    Law and mode, or None where that does not reduce the residual energy.
    """
    plays = start.centre.size
    theta = np.concatenate([start.vector, [math.log(mode.frequency), math.log(mode.damping), mode.share]])
    size = start.vector.size
    rules = shape_rules(plays, size, measured)
    near = np.log(1.1)
    lower = np.concatenate([rules.lower, [theta[-3] - near, math.log(DAMPING_RANGE[0]), 0.0]])
    upper = np.concatenate(
        [
            rules.upper,
            [min(theta[-3] + near, math.log(0.5 / mode.period)), math.log(DAMPING_RANGE[1]), 1.0],
        ]
    )
    largest = np.concatenate([rules.largest, [0.02, 0.5, 0.2]])
    prior = np.concatenate([rules.prior, np.zeros(3)])

    def moved(columns: Floats, extra: Floats) -> Floats:
        out = np.empty_like(columns)
        through_mode(columns, mode_step(math.exp(extra[0]), math.exp(extra[1]), mode.period), out)
        return np.asarray(columns + extra[2] * (out - columns))

    def gap(vector: Floats) -> tuple[Floats, Callable[[], Floats]]:
        extra = vector[size:]
        static, by_shape = evaluate(BankShape.of(vector[:size], plays), temperature)
        column = np.ascontiguousarray(static[:, None])

        def jacobian() -> Floats:
            by_mode = []
            for k, width in enumerate((1e-4, 1e-3, 1e-3)):
                shift = width * np.eye(3)[k]
                by_mode.append((moved(column, extra + shift) - moved(column, extra - shift)) / (2.0 * width))
            return np.hstack([moved(np.ascontiguousarray(by_shape), extra), *by_mode])

        return moved(column, extra)[:, 0] - measured, jacobian

    found = levenberg_marquardt(
        gap,
        theta,
        lower=lower,
        upper=upper,
        largest_step=largest,
        prior=prior,
        steps=iterations,
        tolerance=1e-4,
    )
    before, after = np.sum(gap(theta)[0] ** 2), np.sum(gap(found.theta)[0] ** 2)
    if not after < before:
        return None
    log_frequency, log_damping, share = map(float, found.theta[size:])
    better = ModeFit(math.exp(log_frequency), math.exp(log_damping), share, mode.period, mode.removed)
    return BankShape.of(found.theta[:size], plays), better
