"""The limiting-loop proximity law of de Almeida et al. for the hysteresis of VO2 films.

Between turns the output lies on the limiting branch of the present direction at an input that is shifted towards it,

    s = (1 + tanh x) / 2,    x = a (u + D P((u - u_r) / D) - c),    D = c + x_r / a - u_r,
    P(z) = (1 - sin(gamma z)) (1 + tanh(pi^2 - 2 pi z)) / 2,

with (u_r, x_r) the last turn and a, c slope and centre of the branch (rising or falling). D is the distance of the
turn from that branch, P(0) = 1 keeps the output continuous, and P fades as the input moves away by more than D. Only the
last turn is remembered: minor loops close nearly, not exactly.

L. A. L. de Almeida, G. S. Deep, A. M. N. Lima, H. Neff, "Modeling of the hysteretic metal-insulator transition in a
vanadium dioxide infrared detector", Opt. Eng. 41, 2002, 2582, with one slope for both branches; here each has its own.

    packed = [rising slope, rising centre, falling slope, falling centre, gamma, lower, upper]
    memory = [u, direction, u_r, x_r, x]
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

__all__ = ["LimitingLoop", "move_limiting_loop"]

Floats = NDArray[np.float64]

GAMMA = 0.956
"""gamma of the film of the paper."""


@kernel
def _level(u, direction, turn, level, packed):
    """Argument x of the tanh after a move to u on the branch of `direction` that starts at the turn (turn, level)."""
    at = 0 if direction > 0.0 else 2
    slope = packed[at]
    centre = packed[at + 1]
    shift = 0.0
    if abs(level) < math.inf:
        distance = centre + level / slope - turn
        # a turn beyond the branch, where branches of two slopes cross, is on it
        if distance * direction > 0.0:
            z = (u - turn) / distance
            near = 0.5 * (1.0 - math.sin(packed[4] * z)) * (1.0 + math.tanh(math.pi * (math.pi - 2.0 * z)))
            shift = distance * near
    return slope * (u + shift - centre)


@kernel
def move_limiting_loop(u, packed, memory, make):
    """Compiled step of the law, see `hysteresis.law`."""
    direction = memory[1]
    turn = memory[2]
    level = memory[3]
    x = memory[4]
    if u != memory[0]:
        now = 1.0 if u > memory[0] else -1.0
        if now != direction:
            direction = now
            turn = memory[0]
            level = x
        x = _level(u, direction, turn, level, packed)
    if make:
        memory[0] = u
        memory[1] = direction
        memory[2] = turn
        memory[3] = level
        memory[4] = x
    return packed[5] + (packed[6] - packed[5]) * 0.5 * (1.0 + math.tanh(x))


@kernel
def sweep_limiting_loop(u, packed, memory, out):
    """`move_limiting_loop` along the inputs u (n,)."""
    for k in range(u.size):
        out[k] = move_limiting_loop(u[k], packed, memory, True)


@dataclass(frozen=True, eq=False)
class LimitingLoop(Law):
    """Limiting loop with proximity, see the module.

    Parameters
    ----------
    rising_slope, falling_slope : a of the branches [1 / input unit], above 0
    rising_centre, falling_centre : c of the branches [input unit]; the falling one lies lower
    gamma : of the proximity function, 0 to 1. Near the published 0.956 the output rises with the input; above 1 it would not,
        and below about 0.6 it falls on the way out of a turn (at 0 by more than twice the slope of the branch)
    lower, upper : output far below and far above [output unit]
    polynomial : coefficients of 1, u, u^2 ... of the memoryless part [output unit]

    Raises
    ------
    ValueError : a parameter outside its range, or branches in the wrong order.

    Examples
    --------
    >>> law = LimitingLoop(0.4, 68.0, 0.4, 60.0)
    >>> law.run([20.0, 68.0, 100.0, 60.0]).round(3).tolist()
    [0.0, 0.5, 1.0, 0.5]
    """

    name = "limiting_loop"
    move = staticmethod(move_limiting_loop)
    sweep = staticmethod(sweep_limiting_loop)
    described: ClassVar = {
        "rising_slope": ("1/{u}", "slope of the rising limiting branch"),
        "rising_centre": ("{u}", "centre of the rising limiting branch"),
        "falling_slope": ("1/{u}", "slope of the falling limiting branch"),
        "falling_centre": ("{u}", "centre of the falling limiting branch"),
        "gamma": ("1", "constant of the proximity function"),
        "lower": ("{y}", "output far below the loop"),
        "upper": ("{y}", "output far above the loop"),
        "polynomial": ("{y}", "coefficients of the powers of the input, lowest first,"),
    }

    rising_slope: float
    rising_centre: float
    falling_slope: float
    falling_centre: float
    gamma: float = GAMMA
    lower: float = 0.0
    upper: float = 1.0
    polynomial: ArrayLike = ()

    def __post_init__(self) -> None:
        for name in ("rising_slope", "falling_slope"):
            object.__setattr__(self, name, positive_number(getattr(self, name), name))
        for name in ("rising_centre", "falling_centre", "gamma", "lower", "upper"):
            object.__setattr__(self, name, float(finite_array(getattr(self, name), name, ndim=0)))
        if not self.falling_centre < self.rising_centre:
            raise ValueError(
                f"falling_centre: found {self.falling_centre:g}, need one below rising_centre, {self.rising_centre:g}"
            )
        if not 0.0 <= self.gamma <= 1.0:
            raise ValueError(f"gamma: found {self.gamma:g}, need 0 to 1")
        object.__setattr__(self, "polynomial", finite_array(self.polynomial, "polynomial"))

    @cached_property
    def packed(self) -> Floats:
        """The parameters as `move` takes them."""
        return np.array([getattr(self, name) for name in list(self.described)[:-1]])

    @property
    def memory_size(self) -> int:
        """Length of the memory: input, direction, last turn, its level, present level."""
        return 5

    @property
    def span(self) -> tuple[float, float]:
        """Output far below and far above the loop."""
        return self.lower, self.upper

    def initial_memory(self, saturation: Saturation = "lower") -> Floats:
        """Return the memory far below ("lower") or above ("upper") the loop."""
        return side_of(saturation) * np.array([np.inf, 1.0, np.inf, np.inf, np.inf])
