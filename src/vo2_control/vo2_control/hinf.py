"""H-infinity synthesis, its checks, D-K iteration, order reduction and the discrete controller (section 8.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import control
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vo2_control.generalised_plant import RobustDesign, generalised_plant
from vo2_control.mu import MuSweep, mu_sweep

__all__ = ["PUBLISHED_CONTROLLER", "DesignRefused", "Synthesis", "dk_iterate", "synthesise"]

PUBLISHED_CONTROLLER = control.ss(
    control.zpk(
        [-1.1, -5.3, -8.2, -100.0],
        [-40830.0, -89.0, -1.0, -4.4 + 1.6j, -4.4 - 1.6j],
        -918.0,
    )
)
"""(8.10) as printed, from micrometres to ampere."""


class DesignRefused(ValueError):
    """A design that fails its checks; the message says which and why."""


@dataclass(frozen=True)
class Synthesis:
    """A continuous controller and what it achieves.

    Attributes
    ----------
    design : what it was made from
    controller : K(s) from v = y_ref - y_self [um] to u [A]
    gamma : H-infinity norm of (8.4), over the frequencies of `mu`
    mu : structured singular values over frequency
    """

    design: RobustDesign
    controller: control.StateSpace
    gamma: float
    mu: MuSweep

    @property
    def robust_stability(self) -> float:
        """Largest structured singular value for the uncertainty alone; below 1 is robustly stable."""
        return float(self.mu.robust_stability.max())

    @property
    def robust_performance(self) -> float:
        """Largest structured singular value with the performance block; below 1 is robust performance."""
        return float(self.mu.upper.max())


def synthesise(design: RobustDesign, *, largest_gamma: float = 1.0, expected_sign: int = 0) -> Synthesis:
    """Return the controller of least H-infinity norm for (8.4), uncertainty left open as there.

    Parameters
    ----------
    design : plant and weights
    largest_gamma : refuse above this; 1 means that the weights' demands are met
    expected_sign : sign of deflection over current that the device is known to have, 0 for unknown

    Raises
    ------
    DesignRefused : a sign-flipped plant, an uncontrollable or unobservable plant, an infeasible synthesis, an
        unstable or a not robustly stable loop.

    Examples
    --------
    >>> round(synthesise(RobustDesign()).gamma, 3)
    0.115
    """
    sign = math.copysign(1.0, design.plant.gain)
    if expected_sign and sign != math.copysign(1.0, expected_sign):
        raise DesignRefused(
            f"plant: found a slope of deflection over current of {design.plant.gain:g} m/A, need the sign "
            f"{'+' if expected_sign > 0 else '-'} of this device; identify it again, feedback would diverge"
        )
    plant = generalised_plant(design)
    _check_reachable(plant)
    controller, gamma = _solve(plant[1:, 1:])
    if gamma > largest_gamma:
        raise DesignRefused(
            f"weights: found gamma = {gamma:.3g}, need at most {largest_gamma:g}: the demands on error and effort "
            "contradict each other; lower the performance weight or its corner, or the effort weight"
        )
    return _checked(design, plant, controller)


def _solve(plant: control.StateSpace) -> tuple[control.StateSpace, float]:
    """hinfsyn with one measurement and one command, its failures put into words."""
    try:
        controller, _, gamma, _ = control.hinfsyn(plant, 1, 1)
    except (ArithmeticError, ValueError, control.ControlError) as error:
        raise DesignRefused(
            f"synthesis: infeasible for these weights and plant ({error}); check for weights without a proper "
            "part at high frequency, and gains many decades apart"
        ) from error
    except ImportError as error:
        raise DesignRefused("synthesis: slycot is not installed; pip install slycot") from error
    return controller, float(gamma)


def _check_reachable(plant: control.StateSpace) -> None:
    """Refuse unstable or marginal modes that u cannot reach or v cannot see."""
    size = np.linalg.norm(plant.A, 2)
    identity = np.eye(plant.nstates)
    for pole in plant.poles()[np.real(plant.poles()) > -1e-9]:
        shifted = pole * identity - plant.A
        reached = np.linalg.svd(np.hstack([shifted, plant.B[:, -1:]]), compute_uv=False)[-1]
        seen = np.linalg.svd(np.vstack([shifted, plant.C[-1:]]), compute_uv=False)[-1]
        if min(reached, seen) < 1e-9 * size:
            raise DesignRefused(
                f"plant: found a mode at {pole:.3g} rad/s that the current cannot reach or the estimate cannot "
                "see (uncontrollable), need every unstable or integrating mode controllable"
            )


def _checked(design: RobustDesign, plant: control.StateSpace, controller: control.StateSpace) -> Synthesis:
    closed = plant.lft(controller)
    worst = float(np.real(closed.poles()).max())
    if not worst < 0:
        raise DesignRefused(
            f"loop: found a closed-loop pole at {worst:.3g} rad/s, need all in the left half plane"
        )
    sweep = mu_sweep(plant, controller)
    result = Synthesis(design, controller, float(sweep.nominal.max()), sweep)
    if result.robust_stability >= 1:
        raise DesignRefused(
            f"loop: found a structured singular value of {result.robust_stability:.3g} for the uncertainty, need "
            "below 1: not robustly stable; lower the performance weight or the uncertainty"
        )
    return result


def dk_iterate(design: RobustDesign, *, iterations: int = 4, order: int = 1) -> list[Synthesis]:
    """Return the controllers of a D-K iteration (mu synthesis), beginning with that of `synthesise`.

    Alternates a stable, minimum-phase fit of the optimal D over frequency with the optimal controller for
    D P D^-1. No convergence to the optimum is promised: take the one with the smallest `robust_performance`.

    Parameters
    ----------
    design : plant and weights
    iterations : synthesis steps after the first
    order : of the fitted D(s)

    Raises
    ------
    DesignRefused : as `synthesise`.
    """
    plant = generalised_plant(design)
    results = [synthesise(design, largest_gamma=math.inf)]
    for _ in range(iterations):
        scaling, inverse = _fit_scaling(results[-1].mu, order)
        scaled = (
            control.append(scaling, control.ss([], [], [], np.eye(3)))
            * plant
            * control.append(inverse, control.ss([], [], [], np.eye(5)))
        )
        controller, _ = _solve(scaled)
        results.append(_checked(design, plant, controller))
    return results


def _fit_scaling(mu: MuSweep, order: int) -> tuple[control.StateSpace, control.StateSpace]:
    """Fit |D(i w)| by real lead-lags, with weight where the structured singular value is large."""
    omega, target = mu.frequency_rad_s, np.log(mu.scaling)
    weight = (mu.upper / mu.upper.max()) ** 2

    def magnitude(p: NDArray[np.float64]) -> NDArray[np.float64]:
        total = np.full(omega.shape, p[0])
        for k in range(order):
            total = total + 0.5 * np.log1p((omega / np.exp(p[1 + 2 * k])) ** 2)
            total = total - 0.5 * np.log1p((omega / np.exp(p[2 + 2 * k])) ** 2)
        return total

    start = np.concatenate([[float(np.average(target, weights=weight))], np.linspace(-2, 2, 2 * order)])
    fit = least_squares(
        lambda p: weight * (magnitude(p) - target),
        start,
        bounds=([-20, *[-8] * 2 * order], [20, *[8] * 2 * order]),
    )
    zeros, poles = -np.exp(fit.x[1::2]), -np.exp(fit.x[2::2])
    gain = float(np.exp(fit.x[0]) * np.prod(-poles) / np.prod(-zeros))
    return control.ss(control.zpk(zeros, poles, gain)), control.ss(control.zpk(poles, zeros, 1 / gain))
