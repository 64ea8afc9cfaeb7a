"""Levenberg-Marquardt least squares with bounds and a Gaussian prior, for Jacobians that are expensive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

__all__ = ["LeastSquares", "levenberg_marquardt"]

Floats = NDArray[np.float64]
Evaluate = Callable[[Floats], tuple[Floats, Callable[[], Floats]]]
"""theta (p,) -> residual (n,) and a function that gives its Jacobian (n, p) there."""


@dataclass(frozen=True)
class LeastSquares:
    """Result.

    Attributes
    ----------
    theta : (p,) minimiser
    residual : (n,) there
    jacobian : (n, p) of the residual there
    cost : squared residual plus prior
    steps : steps taken
    """

    theta: Floats
    residual: Floats = field(repr=False)
    jacobian: Floats = field(repr=False)
    cost: float
    steps: int


def levenberg_marquardt(
    evaluate: Evaluate,
    start: Floats,
    *,
    lower: Floats,
    upper: Floats,
    largest_step: Floats | float = np.inf,
    prior: Floats | float = 0.0,
    steps: int = 60,
    tolerance: float = 1e-4,
) -> LeastSquares:
    """Minimise |r(theta)|^2 + sum prior (theta - start)^2 within bounds.

    A parameter at a bound that the gradient pushes outwards is held for that step. The fit ends after two steps that
    each lower the cost by less than `tolerance` of it, or when no damping gives a lower cost.

    Parameters
    ----------
    evaluate : see `Evaluate`
    start : (p,)
    lower, upper : (p,) bounds
    largest_step : (p,) or number: most change of a parameter in one step
    prior : (p,) or number: precision of the prior around the start
    steps : most steps
    tolerance : relative drop of the cost below which the search ends

    Returns
    -------
    LeastSquares : minimiser, residual and Jacobian there
    """
    stiff = np.broadcast_to(np.asarray(prior, dtype=np.float64), start.shape)
    theta = np.clip(start, lower, upper)
    residual, jacobian_at = evaluate(theta)
    cost = float(residual @ residual + stiff @ (theta - start) ** 2)
    jacobian = jacobian_at()
    damping, quiet, taken = 1e-2, 0, 0
    while taken < steps and quiet < 2:
        normal = jacobian.T @ jacobian + np.diag(stiff)
        descent = -(jacobian.T @ residual) - stiff * (theta - start)
        free = ~(((theta <= lower) & (descent < 0.0)) | ((theta >= upper) & (descent > 0.0)))
        free &= np.diag(normal) > 0.0
        if not np.any(free):
            break
        normal, descent = normal[np.ix_(free, free)], descent[free]
        # unit diagonal: the parameters' units and sizes do not matter
        scale = np.sqrt(np.diag(normal))
        normal = normal / np.outer(scale, scale)
        for _ in range(10):
            damped = normal + (damping + 1e-12) * np.eye(scale.size)
            move = np.zeros(theta.size)
            move[free] = cho_solve(cho_factor(damped), descent / scale) / scale
            trial = np.clip(theta + np.clip(move, -np.asarray(largest_step), largest_step), lower, upper)
            residual_then, jacobian_at = evaluate(trial)
            cost_then = float(residual_then @ residual_then + stiff @ (trial - start) ** 2)
            if cost_then < cost:
                break
            damping *= 4.0
        else:
            break
        quiet = quiet + 1 if cost - cost_then < tolerance * cost else 0
        theta, residual, cost = trial, residual_then, cost_then
        jacobian = jacobian_at()
        damping = max(damping / 5.0, 1e-9)
        taken += 1
    return LeastSquares(theta, residual, jacobian, cost, taken)
