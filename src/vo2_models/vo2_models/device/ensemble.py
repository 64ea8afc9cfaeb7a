"""Ground truth of the phase transition: thousands of domains that switch one by one.

A domain turns metallic where the temperature reaches its heating temperature alpha and back where it falls
to its cooling temperature beta < alpha: a hysteron (5.3) with its own place in the Preisach plane. The
structural transition of the same domain lies a material-dependent offset higher (section 8.2).

The kernels keep the domains sorted by both temperatures and touch only those that a move crosses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.numerics.kernel import kernel

__all__ = ["NARROWEST", "count_above", "ensemble_peek", "ensemble_step", "population", "sort_population"]

NARROWEST = 0.3
"""Smallest loop width of a domain [K]; the normal distribution's tail below it is folded onto it."""

# Generalised golden ratio of dimension 3: the R3 low-discrepancy sequence (M. Roberts, 2018).
_PHI = 1.2207440846057596


def population(
    count: int,
    *,
    heating: tuple[float, float],
    width: tuple[float, float],
    offset: tuple[float, float],
    seed: int | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Draw domains.

    Parameters
    ----------
    count : number of domains
    heating, width, offset : mean and standard deviation over the material [K, degC] of the heating
        temperature, the loop width and the structural minus metallic transition
    seed : of the drawing; None takes quantiles at an even sequence instead, a device without scatter

    Returns
    -------
    alpha, beta, offset : (count,) heating and cooling temperatures [degC], structural offset [K]
    """
    from scipy.special import ndtri  # loads slowly, and a node starts without it

    if count < 1:
        raise ValueError(f"count: found {count}, need at least 1 domain")
    if seed is None:
        k = np.arange(1, count + 1)[:, None]
        normal = ndtri((0.5 + k * _PHI ** -np.arange(1.0, 4.0)) % 1.0)
    else:
        normal = np.random.default_rng(seed).standard_normal((count, 3))
    alpha = heating[0] + heating[1] * normal[:, 0]
    beta = alpha - np.maximum(width[0] + width[1] * normal[:, 1], NARROWEST)
    return alpha, beta, offset[0] + offset[1] * normal[:, 2]


def sort_population(
    alpha: NDArray[np.float64], beta: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (2, n) sorted heating and cooling temperatures [degC] and (2, n) the domains they belong to.

    Parameters
    ----------
    alpha, beta : (n,) temperatures at which a domain switches on heating and on cooling [degC]
    """
    orders = np.array([np.argsort(alpha, kind="stable"), np.argsort(beta, kind="stable")])
    return np.ascontiguousarray([alpha[orders[0]], beta[orders[1]]]), orders


@kernel
def count_above(levels, which, side, value):
    """Number of levels not above `value` (a search without a slice, which would cost reference counts)."""
    low, high = 0, levels.shape[2]
    while low < high:
        middle = (low + high) // 2
        if levels[which, side, middle] <= value:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def _from(levels, which, side, value):
    """Number of levels below `value`."""
    low, high = 0, levels.shape[2]
    while low < high:
        middle = (low + high) // 2
        if levels[which, side, middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def ensemble_step(temperature, previous, which, levels, domains, metallic, count):
    """Move the ensemble from `previous` to `temperature`; return the number of metallic domains.

    `levels`, `domains` : (m, 2, n), each member as from `sort_population`; `metallic` : (m, n) uint8, updated in
    place; `which` : the member to move.
    """
    if temperature > previous:
        k = count_above(levels, which, 0, previous)
        while k < metallic.shape[1] and levels[which, 0, k] <= temperature:
            domain = domains[which, 0, k]
            count += 1 - metallic[which, domain]
            metallic[which, domain] = 1
            k += 1
    elif temperature < previous:
        k = _from(levels, which, 1, previous) - 1
        while k >= 0 and levels[which, 1, k] >= temperature:
            domain = domains[which, 1, k]
            count -= metallic[which, domain]
            metallic[which, domain] = 0
            k -= 1
    return count


@kernel
def ensemble_peek(temperature, previous, which, levels, domains, metallic, count):
    """Number of metallic domains after a move to `temperature` that is not made."""
    if temperature > previous:
        k = count_above(levels, which, 0, previous)
        while k < metallic.shape[1] and levels[which, 0, k] <= temperature:
            count += 1 - metallic[which, domains[which, 0, k]]
            k += 1
    elif temperature < previous:
        k = _from(levels, which, 1, previous) - 1
        while k >= 0 and levels[which, 1, k] >= temperature:
            count -= metallic[which, domains[which, 1, k]]
            k -= 1
    return count
