"""What every feedback controller offers, and the one sampled linear law with limits behind all of them.

PI, PID and H-infinity controllers are the same object at run time: a small discrete state-space law from
(reference, estimate) to a current, followed by range and rate limits whose effect is fed back into the
law's state. They differ only in how the matrices are designed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from vo2_models.validation import finite_array, positive_number

__all__ = [
    "Controller",
    "Coordinate",
    "CurrentLimits",
    "LinearController",
    "LinearLaw",
    "limited_step",
]

Row = list[float] | NDArray[np.float64]
Rows = list[list[float]] | NDArray[np.float64]

Coordinate = Literal["current", "heating_power"]
"""What the law computes: the current itself [A], or its square [A^2], which is linear in the temperature
of a Joule heater, T = T0 + k i^2 (eq. 7.1), so that the loop gain no longer grows with the current."""


class Controller(Protocol):
    """A feedback controller at a fixed sample period."""

    @property
    def sample_period_s(self) -> float:
        """Time between calls of `update` [s]."""
        ...

    @property
    def state(self) -> NDArray[np.float64]:
        """A copy of the complete memory; assigning it restores the controller exactly."""
        ...

    @state.setter
    def state(self, value: NDArray[np.float64]) -> None: ...

    def update(self, reference_m: float, estimate_m: float, feedforward_a: float = 0.0) -> float:
        """Advance one sample; return the current [A] to apply until the next one."""
        ...

    def reset(
        self, current_a: float, reference_m: float, estimate_m: float, feedforward_a: float = 0.0
    ) -> float:
        """Start anew so that the next `update` with these signals continues from `current_a` [A].

        Return the current that this is, within the limits [A].
        """
        ...


@dataclass(frozen=True)
class CurrentLimits:
    """Range [A] and rate [A/s] that a commanded current never leaves."""

    lower_a: float
    upper_a: float
    rate_a_per_s: float = math.inf

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower_a) and math.isfinite(self.upper_a)):
            raise ValueError(f"limits: found {self.lower_a} to {self.upper_a} A, need finite currents")
        if self.lower_a >= self.upper_a:
            raise ValueError(
                f"limits: found lower {self.lower_a:g} A, need less than upper {self.upper_a:g} A"
            )
        if not self.rate_a_per_s > 0:
            raise ValueError(f"rate_a_per_s: found {self.rate_a_per_s}, need a number above 0")


@dataclass(frozen=True)
class LinearLaw:
    """A discrete law v = operating + c x + d (r, y), x+ = a x + b (r, y) + conditioning (v_applied - v).

    Attributes
    ----------
    a : (n, n); b : (n, 2); c : (n,); d : (2,) with inputs reference r and estimate y [m]
    conditioning : (n,) how the part of the output that the limits removed corrects the state: back-calculation
        for an integrator, an observer gain in general (Hanus' conditioning is the case b/d)
    sample_period_s : [s]
    coordinate : unit of v, see `Coordinate`
    operating_a : current about which a law without integral action was designed [A]
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    c: NDArray[np.float64]
    d: NDArray[np.float64]
    conditioning: NDArray[np.float64]
    sample_period_s: float
    coordinate: Coordinate = "current"
    operating_a: float = 0.0

    def __post_init__(self) -> None:
        a = finite_array(self.a, "a", ndim=2)
        n = a.shape[0]
        wanted = {"a": (n, n), "b": (n, 2), "c": (n,), "d": (2,), "conditioning": (n,)}
        for name, shape in wanted.items():
            array = finite_array(getattr(self, name), name, ndim=len(shape))
            if array.shape != shape:
                raise ValueError(f"{name}: found shape {array.shape}, need {shape}")
            object.__setattr__(self, name, array)
        positive_number(self.sample_period_s, "sample_period_s")
        if self.coordinate not in ("current", "heating_power"):
            raise ValueError(f"coordinate: found {self.coordinate!r}, need current or heating_power")

    @property
    def order(self) -> int:
        """Number of states n."""
        return self.a.shape[0]

    def start_maps(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (n,) and (n, 2): the bumpless start x = first * v + second (r, y).

        Among the states whose output is v, it is the one that moves least in the next sample; a law
        with integral action starts at rest when r equals y.
        """
        if self.order == 0 or not np.any(self.c):
            return np.zeros(self.order), np.zeros((self.order, 2))
        onto = self.c / (self.c @ self.c)
        _, _, rows = np.linalg.svd(self.c[None, :])
        free = rows[1:].T
        still = np.eye(self.order) - self.a
        settle = -free @ np.linalg.pinv(still @ free) if free.size else np.zeros((self.order, self.order))
        from_v = onto + settle @ (still @ onto)
        from_w = -np.outer(onto, self.d) - settle @ (still @ np.outer(onto, self.d) + self.b)
        return from_v, from_w


def limited_step(
    a: Rows,
    b: Rows,
    c: Row,
    d: Row,
    conditioning: Row,
    squared: bool,
    lower_a: float,
    upper_a: float,
    largest_change_a: float,
    state: Row,
    following: Row,
    reference_m: float,
    estimate_m: float,
    ahead_a: float,
) -> float:
    """Make one step of a `LinearLaw` behind its limits; return the current [A].

    Plain loops: studies compile this very function with numba for arrays, nodes call it as it is with lists of floats,
    which a few states are faster in than in arrays.

    Parameters
    ----------
    a, b, c, d, conditioning, squared : of the `LinearLaw`
    lower_a, upper_a : limits of the current [A]
    largest_change_a : of the current in one sample [A]
    state : (n + 1,) state and the current applied before [A]; updated in place
    following : (n,) room to work in
    reference_m, estimate_m : wanted and estimated deflection [m]
    ahead_a : added in the law's coordinate [A]: the operating current plus any feedforward, so that one set of limits
        and one anti-windup serve both
    """
    v = d[0] * reference_m + d[1] * estimate_m
    v += ahead_a * abs(ahead_a) if squared else ahead_a
    n = len(c)
    for j in range(n):
        v += c[j] * state[j]
    before = state[n]
    wanted = (math.sqrt(v) if v > 0.0 else 0.0) if squared else v
    current = min(max(wanted, before - largest_change_a), before + largest_change_a)
    current = min(max(current, lower_a), upper_a)
    # the law without limits must see no rounding from the square root and back
    removed = 0.0
    if current != wanted or (squared and v < 0.0):
        removed = (current * current if squared else current) - v
    for i in range(n):
        row = a[i]
        total = b[i][0] * reference_m + b[i][1] * estimate_m + conditioning[i] * removed
        for j in range(n):
            total += row[j] * state[j]
        following[i] = total
    for i in range(n):
        state[i] = following[i]
    state[n] = current
    return current


@dataclass
class LinearController:
    """A `LinearLaw` behind `CurrentLimits`, with explicit memory (implements `Controller`).

    Raises
    ------
    ValueError : `heating_power` with negative currents allowed; a signal that is not finite.
    """

    law: LinearLaw
    limits: CurrentLimits
    _state: list[float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.law.coordinate == "heating_power" and self.limits.lower_a < 0:
            raise ValueError(
                f"limits: found lower {self.limits.lower_a:g} A, need at least 0 A: heating power has no sign"
            )
        self._starts = self.law.start_maps()
        self._arguments = (
            self.law.a.tolist(),
            self.law.b.tolist(),
            self.law.c.tolist(),
            self.law.d.tolist(),
            self.law.conditioning.tolist(),
            self.law.coordinate == "heating_power",
            self.limits.lower_a,
            self.limits.upper_a,
            self.limits.rate_a_per_s * self.law.sample_period_s,
        )
        self._following = [0.0] * self.law.order
        self._state = [0.0] * self.law.order + [min(max(0.0, self.limits.lower_a), self.limits.upper_a)]

    @property
    def sample_period_s(self) -> float:
        return self.law.sample_period_s

    @property
    def state(self) -> NDArray[np.float64]:
        """(n + 1,): the law's state and the current applied last [A]; a copy."""
        return np.array(self._state)

    @state.setter
    def state(self, value: NDArray[np.float64]) -> None:
        self._state = finite_array(value, "state", size=self.law.order + 1).tolist()

    def update(self, reference_m: float, estimate_m: float, feedforward_a: float = 0.0) -> float:
        """Advance one sample; return the current [A].

        Parameters
        ----------
        reference_m, estimate_m : [m]
        feedforward_a : current that the feedback corrects [A], see `vo2_control.feedforward`

        Raises
        ------
        ValueError : a signal that is not finite; the memory is then unchanged.
        """
        if not (math.isfinite(reference_m) and math.isfinite(estimate_m) and math.isfinite(feedforward_a)):
            raise ValueError(
                f"update: found reference {reference_m} m, estimate {estimate_m} m and feedforward "
                f"{feedforward_a} A, need finite numbers"
            )
        ahead = self.law.operating_a + feedforward_a
        return limited_step(*self._arguments, self._state, self._following, reference_m, estimate_m, ahead)

    def reset(
        self, current_a: float, reference_m: float, estimate_m: float, feedforward_a: float = 0.0
    ) -> float:
        """Start bumplessly from `current_a` [A], clipped to the range, at the given signals [m]; return it clipped."""
        signals = finite_array([reference_m, estimate_m], "reference_m, estimate_m")
        current = min(
            max(float(finite_array(current_a, "current_a", ndim=0)), self.limits.lower_a), self.limits.upper_a
        )
        ahead = self.law.operating_a + float(finite_array(feedforward_a, "feedforward_a", ndim=0))
        v = current - ahead
        if self.law.coordinate == "heating_power":
            v = current * current - ahead * abs(ahead)
        from_v, from_w = self._starts
        self._state = [*(from_v * v + from_w @ signals).tolist(), current]
        return current
