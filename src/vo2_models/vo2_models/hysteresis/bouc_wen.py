"""The Bouc-Wen law in its normalised, rate-independent form.

    dw/du = rho (1 - |w|^n (1 - sigma + sigma sign(w du))),        y = amplitude w + polynomial(u)

w runs from -1 to 1 whatever the parameters are: rho says how soon the loop saturates, n how sharply, and sigma how the
way back differs from the way there. The four constants of Bouc (4th Conf. Nonlinear Oscillations, Prague 1967) and
Wen (J. Eng. Mech. ASCE 102, 1976, 249) hold one too many; this form is that of Ikhouane and Rodellar, "Systems with
Hysteresis", Wiley 2007, section 2.3.

    packed = [rho, sigma, n, amplitude]
    memory = [u, w]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import Law, Saturation, side_of
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array, positive_number

__all__ = ["BoucWen", "move_bouc_wen"]

Floats = NDArray[np.float64]

STEP = 0.04
"""Longest step of rho u of the fourth-order integration. It is shorter where the slope changes sooner, as the slope and n say:
the error stays below 2e-6 of the amplitude for sigma up to 50 and n up to 20."""
NEWTON = 4
"""Iterations for the place that a way ends at; each doubles the digits."""
SATURATED = 1e-14
"""Distance of |w| from 1 at which it stays there."""

# Gauss and Legendre's five points on [0, 1]
_NODES = tuple(0.5 * (1.0 + x) for x in np.polynomial.legendre.leggauss(5)[0].tolist())
_WEIGHTS = tuple(0.5 * w for w in np.polynomial.legendre.leggauss(5)[1].tolist())


@kernel(inline="always")
def _slope(w, direction, sigma, n):
    """dw / d(rho u) for a move in the given direction."""
    turn = sigma if w * direction > 0.0 else -sigma
    return 1.0 - abs(w) ** n * (1.0 - sigma + turn)


@kernel(inline="always")
def _way(w, to, direction, sigma, n):
    """Way in rho u from w to another value on the same side of 0: the integral of 1 / slope."""
    way = 0.0
    for j in range(5):
        way += _WEIGHTS[j] / _slope(w + (to - w) * _NODES[j], direction, sigma, n)
    return way * abs(to - w)


@kernel
def move_bouc_wen(u, packed, memory, make):
    """Compiled step of the law, see `hysteresis.law`."""
    sigma = packed[1]
    n = packed[2]
    w = memory[1]
    direction = 1.0 if u > memory[0] else -1.0
    left = packed[0] * abs(u - memory[0])
    if left == math.inf:
        w = direction
        left = 0.0
    if u != u:
        w = math.nan
        left = 0.0
    while left > 0.0:
        if w * direction > 0.0 and 1.0 - abs(w) < SATURATED:
            w = direction
            break
        k1 = _slope(w, direction, sigma, n)
        stiff = max(k1, 1.0)
        if w * direction < 0.0:
            stiff = max(stiff, (2.0 * sigma - 1.0) * abs(w) ** (n - 1.0))
        h = min(left, STEP / max(1.0, 0.5 * n * stiff))
        step = direction * h
        if w * direction < 0.0 and abs(w) <= 1.5 * h * k1:
            # the slope has a corner at w = 0: the way there comes from the integral of 1 / slope
            if _way(w, 0.0, direction, sigma, n) <= left:
                left -= _way(w, 0.0, direction, sigma, n)
                w = 0.0
                continue
            # and so does the place where it ends before
            to = w + direction * left * k1
            if to * direction > 0.0:
                to = 0.0
            for _ in range(NEWTON):
                to += direction * (left - _way(w, to, direction, sigma, n)) * _slope(to, direction, sigma, n)
                to = min(max(to, -1.0), 1.0)
            w = to
            break
        k2 = _slope(w + 0.5 * step * k1, direction, sigma, n)
        k3 = _slope(w + 0.5 * step * k2, direction, sigma, n)
        k4 = _slope(w + step * k3, direction, sigma, n)
        w = min(max(w + step * (k1 + 2.0 * k2 + 2.0 * k3 + k4) / 6.0, -1.0), 1.0)
        left -= h
    if make:
        memory[0] = u
        memory[1] = w
    return packed[3] * w


@kernel
def sweep_bouc_wen(u, packed, memory, out):
    """`move_bouc_wen` along the inputs u (n,)."""
    for k in range(u.size):
        out[k] = move_bouc_wen(u[k], packed, memory, True)


@dataclass(frozen=True, eq=False)
class BoucWen(Law):
    """Bouc-Wen hysteresis, see the module.

    Parameters
    ----------
    rho : how fast the hysteretic part follows the input after a turn [1 / input unit], above 0
    sigma : at least 1/2, below which the law would give energy away; at 1/2 the way back starts with the slope rho
    n : sharpness of the knee, at least 1
    amplitude : of the hysteretic part [output unit]
    polynomial : coefficients of 1, u, u^2 ... of the memoryless part [output unit]

    Raises
    ------
    ValueError : a parameter outside its range, or not finite.

    Examples
    --------
    With n = 1 and sigma = 1/2 the branch from w = 0 is 1 - exp(-rho u) and the way back a straight line:

    >>> law = BoucWen(rho=1.0, sigma=0.5, n=1.0)
    >>> memory = np.array([0.0, 0.0])
    >>> [round(law.step(u, memory), 6) for u in (1.0, 0.5)]
    [0.632121, 0.132121]
    """

    name = "bouc_wen"
    move = staticmethod(move_bouc_wen)
    sweep = staticmethod(sweep_bouc_wen)
    described: ClassVar = {
        "rho": ("1/{u}", "rate of the hysteretic part after a turn"),
        "sigma": ("1", "asymmetry between the way there and back"),
        "n": ("1", "sharpness of the knee"),
        "amplitude": ("{y}", "amplitude of the hysteretic part"),
        "polynomial": ("{y}", "coefficients of the powers of the input, lowest first,"),
    }

    rho: float
    sigma: float = 0.5
    n: float = 1.0
    amplitude: float = 1.0
    polynomial: ArrayLike = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "rho", positive_number(self.rho, "rho"))
        for name, least in (("sigma", 0.5), ("n", 1.0), ("amplitude", -np.inf)):
            value = float(finite_array(getattr(self, name), name, ndim=0))
            if value < least:
                raise ValueError(f"{name}: found {value:g}, need at least {least:g}")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "polynomial", finite_array(self.polynomial, "polynomial"))

    @cached_property
    def packed(self) -> Floats:
        """The parameters as `move` takes them."""
        return np.array([self.rho, self.sigma, self.n, self.amplitude])

    @property
    def memory_size(self) -> int:
        """Length of the memory: input and w."""
        return 2

    @property
    def span(self) -> tuple[float, float]:
        """Hysteretic output after a long way down and after a long way up."""
        return -self.amplitude, self.amplitude

    def initial_memory(self, saturation: Saturation = "lower") -> Floats:
        """Return the memory after a way down ("lower") or up ("upper") without end."""
        side = side_of(saturation)
        return np.array([side * np.inf, side])
