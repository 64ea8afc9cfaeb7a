"""Checks at the boundary: one place that turns bad input into one clear `ValueError`.

Every message names the argument, what was found and what is needed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["finite_array", "increasing", "nonnegative", "positive_number"]


def finite_array(
    value: ArrayLike, name: str, *, ndim: int | Sequence[int] | None = 1, size: int | None = None
) -> NDArray[np.float64]:
    """Return `value` as a contiguous float64 array without NaN or infinity.

    Parameters
    ----------
    value : array_like, any real numbers
    name : the argument's name, for the message
    ndim : the allowed number(s) of dimensions, None for any
    size : the required number of elements, None for any

    Raises
    ------
    ValueError : not numeric, wrong shape, or not finite (with the first offending index).
    """
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: found {type(value).__name__} that is not numeric ({error})") from error
    if np.ndim(value) == 0:
        array = array.reshape(())
    allowed = (ndim,) if isinstance(ndim, int) else ndim
    if allowed is not None and array.ndim not in allowed:
        wanted = " or ".join(str(n) for n in allowed)
        raise ValueError(f"{name}: found shape {array.shape}, need {wanted} dimension(s)")
    if size is not None and array.size != size:
        raise ValueError(f"{name}: found {array.size} value(s), need {size}")
    if not np.all(np.isfinite(array)):
        where = np.unravel_index(int(np.flatnonzero(~np.isfinite(array))[0]), array.shape or (1,))
        found = array.flat[int(np.flatnonzero(~np.isfinite(array))[0])]
        raise ValueError(
            f"{name}: found {found} at index {tuple(map(int, where))}, need finite values; "
            "remove or interpolate such samples first"
        )
    return array


def increasing(array: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return `array` (n,) if strictly increasing, else raise a `ValueError` with the place.

    Parameters
    ----------
    name : what the array is called in the message
    """
    steps = np.diff(array)
    if np.any(steps <= 0):
        k = int(np.flatnonzero(steps <= 0)[0])
        raise ValueError(
            f"{name}: found {array[k + 1]:g} after {array[k]:g} at index {k + 1}, need strictly increasing values"
        )
    return array


def nonnegative(array: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """Return `array` if no element is negative, else raise a `ValueError` with the place.

    Parameters
    ----------
    name : what the array is called in the message
    """
    if np.any(array < 0):
        k = int(np.flatnonzero(array.ravel() < 0)[0])
        raise ValueError(f"{name}: found {array.ravel()[k]:g} at index {k}, need values >= 0")
    return array


def positive_number(value: float, name: str) -> float:
    """Return `value` as a float if finite and above zero, else raise a `ValueError`.

    Parameters
    ----------
    name : what the value is called in the message
    """
    number = float(value)
    if not np.isfinite(number) or number <= 0:
        raise ValueError(f"{name}: found {value!r}, need a finite number above 0")
    return number
