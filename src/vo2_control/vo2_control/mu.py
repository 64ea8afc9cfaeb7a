"""Structured singular value over frequency, robust stability and performance, and D-K iteration (section 8.3.2)."""

from __future__ import annotations

from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import NDArray

__all__ = ["MuSweep", "closed_loop_response", "mu_sweep", "structured_singular_value"]

Complex = NDArray[np.complex128]
Array = NDArray[np.float64]

_GOLDEN = (np.sqrt(5.0) - 1) / 2


@dataclass(frozen=True)
class MuSweep:
    """Structured singular values of a closed loop M = F_l(P, K) over frequency.

    Attributes
    ----------
    frequency_rad_s : (m,)
    robust_stability : (m,) |M11|, the structured singular value for the uncertainty alone
    upper, lower : (m,) bounds of the structured singular value with the performance block; equal up to
        rounding, as the upper bound is exact for two complex blocks
    nominal : (m,) largest singular value of M22; its largest element is the H-infinity norm of (8.4)
    scaling : (m,) the optimal D at each frequency (the uncertainty's channel relative to performance)
    """

    frequency_rad_s: Array
    robust_stability: Array
    upper: Array
    lower: Array
    nominal: Array
    scaling: Array


def closed_loop_response(
    plant: control.StateSpace, controller: control.StateSpace, frequency_rad_s: Array
) -> Complex:
    """Return M = F_l(P, K) (m, outputs - 1, inputs - 1), pointwise from the two responses.

    Pointwise, and not from the closed loop's matrices, so that it checks those.

    Parameters
    ----------
    plant : P(s)
    controller : K(s)
    frequency_rad_s : (m,) [rad/s]
    """
    p = np.moveaxis(plant.frequency_response(frequency_rad_s, squeeze=False).frdata, 2, 0)
    k = controller.frequency_response(frequency_rad_s, squeeze=False).frdata[0, 0]
    inner = k / (1 - p[:, -1, -1] * k)
    return p[:, :-1, :-1] + inner[:, None, None] * p[:, :-1, -1:] * p[:, -1:, :-1]


def structured_singular_value(m: Complex) -> tuple[Array, Array, Array]:
    """Return (upper, lower, scaling) for one scalar complex uncertainty and one full complex block (8.11).

    The upper bound is the least over D of the largest singular value of D M D^-1, convex in log D, hence found by
    golden section; for two full blocks it equals the structured singular value (Packard and Doyle, Automatica
    29, 1993). The lower bound is found without D: beta is attained if for some phase the uncertainty
    exp(i phase) / beta drives the norm of the remaining loop to beta.

    Parameters
    ----------
    m : (n, p, q) with the uncertainty in the first row and column
    """
    upper, scaling = _upper_bound(m)
    return upper, _lower_bound(m, upper), scaling


def _upper_bound(m: Complex) -> tuple[Array, Array]:
    low, high = np.full(m.shape[0], -15.0), np.full(m.shape[0], 15.0)
    for _ in range(60):
        left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        go_left = _scaled_norm(m, left) <= _scaled_norm(m, right)
        high, low = np.where(go_left, right, high), np.where(go_left, low, left)
    log_d = 0.5 * (low + high)
    return _scaled_norm(m, log_d), np.exp(log_d)


def _scaled_norm(m: Complex, log_d: Array) -> Array:
    """Largest singular value of D M D^-1 with D = diag(d, 1, ..., 1)."""
    d = np.exp(log_d)[:, None]
    scaled = m.copy()
    scaled[:, 0, 1:] *= d
    scaled[:, 1:, 0] /= d
    return _largest_singular_value(scaled)


def _largest_singular_value(m: Complex) -> Array:
    """Through the smaller Gram matrix: many tiny matrices, and only the top value is wanted."""
    if m.shape[-2] > m.shape[-1]:
        m = np.swapaxes(m, -1, -2)
    gram = m @ np.swapaxes(m.conj(), -1, -2)
    if gram.shape[-1] == 2:
        first, last = gram[..., 0, 0].real, gram[..., 1, 1].real
        return np.sqrt(0.5 * (first + last) + np.hypot(0.5 * (first - last), np.abs(gram[..., 0, 1])))
    return np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[..., -1], 0.0))


def _lower_bound(m: Complex, upper: Array) -> Array:
    # where M11 alone nearly reaches beta only phases close to its own count: a grid that is fine there
    steps = np.concatenate([[0.0], np.logspace(-6, -1.5, 15), np.linspace(0.05, np.pi, 60)])
    offset = np.concatenate([-steps[:0:-1], steps])
    turn = np.exp(1j * (offset[None, :] - np.angle(m[:, :1, 0])))
    low = np.maximum(np.abs(m[:, 0, 0]), _largest_singular_value(m[:, 1:, 1:]))
    high = upper * (1 + 1e-9)
    outer = m[:, 1:, :1] * m[:, :1, 1:]
    for _ in range(30):
        beta = 0.5 * (low + high)
        delta = turn / beta[:, None]
        inner = delta / (1 - m[:, :1, 0] * delta)
        loop = m[:, None, 1:, 1:] + inner[:, :, None, None] * outer[:, None]
        attained = _largest_singular_value(loop).max(axis=1) >= beta
        low, high = np.where(attained, beta, low), np.where(attained, high, beta)
    return np.asarray(low)


def mu_sweep(
    plant: control.StateSpace,
    controller: control.StateSpace,
    frequency_rad_s: Array | None = None,
    *,
    lower_bound: bool = True,
) -> MuSweep:
    """Return the structured singular values of F_l(P, K) over frequency.

    Parameters
    ----------
    plant : from `vo2_control.generalised_plant.generalised_plant`
    controller : from v = y_ref - y_self to u, in the plant's units
    frequency_rad_s : (m,); None for 300 points from 1e-4 to 1e3 rad/s
    lower_bound : False leaves `lower` NaN and is three times as fast
    """
    frequency = np.logspace(-4, 3, 300) if frequency_rad_s is None else np.asarray(frequency_rad_s, float)
    m = closed_loop_response(plant, controller, frequency)
    upper, scaling = _upper_bound(m)
    lower = _lower_bound(m, upper) if lower_bound else np.full(upper.shape, np.nan)
    return MuSweep(
        frequency_rad_s=frequency,
        robust_stability=np.abs(m[:, 0, 0]),
        upper=upper,
        lower=lower,
        nominal=_largest_singular_value(m[:, 1:, 1:]),
        scaling=scaling,
    )
