"""How well a record determines a fitted play model: covariance of all its parameters, the linear ones included.

At the solution the full Jacobian J holds the derivatives with respect to the envelopes and the
memoryless parameters, and the active regressors. The covariance is s^2 (J^T J)^+, with s^2 from the residual and its
degrees of freedom, times (1 + rho) / (1 - rho), where rho is the residual's correlation from sample to sample (0 if
negative): a smooth model error repeats itself and is not averaged away by sampling faster.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.fitting_projection import Projection

__all__ = ["uncertainties"]

FloatArray = NDArray[np.float64]


def _correlation_factor(residual: FloatArray) -> float:
    energy = float(residual @ residual)
    if energy <= 0 or residual.size < 3:
        return 1.0
    rho = float(residual[1:] @ residual[:-1]) / energy
    rho = min(max(rho, 0.0), 1 - 2 / residual.size)
    return (1 + rho) / (1 - rho)


def uncertainties(
    projection: Projection, x: FloatArray, input_map: tuple[float, float], output_map: tuple[float, float]
) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Names, values and covariance of the parameters in the units of the record, as the fitted model has them.

    Of a memoryless polynomial the coefficients are those of v, v^2 ...; of a tanh the parameters are gain and offset, the
    coefficient its amplitude; of a sine the parameter is its frequency, the coefficients amplitude and phase.

    Parameters
    ----------
    projection : the fit
    x : (n,) inputs
    input_map, output_map : offset and scale from the record's units to the fit's

    Returns
    -------
    tuple : names, values (p,) and covariance (p, p)
    """
    (centre, half), (offset, scale) = input_map, output_map
    parameters = projection.parameters
    linear = projection.linear(x)
    arguments, theta = parameters.unpack(x)
    pairs = parameters.pairs
    extra = parameters.basis.columns(projection.z, theta)
    regressors = np.concatenate([projection.regressors(x), np.ones((projection.z.size, 1)), extra], axis=1)
    amounts = np.concatenate([linear.weights, [linear.bias], linear.coefficients])
    at_bound = np.concatenate(
        [
            linear.weights == 0,
            [False],
            (linear.coefficients == 0)
            if parameters.basis.nonnegative
            else np.zeros(extra.shape[1], dtype=bool),
        ]
    )
    regressors[:, at_bound] = 0.0
    jacobian = np.concatenate([projection.natural(x), regressors], axis=1)
    moved = np.linalg.norm(jacobian, axis=0)
    moved[moved <= 1e-9 * np.max(moved)] = 0.0
    used = moved > 0
    freedom = max(projection.z.size - int(np.count_nonzero(used)), 1)
    variance = float(linear.residual @ linear.residual) / freedom * _correlation_factor(linear.residual)
    scaled = jacobian[:, used] / moved[used]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    covariance = np.zeros((moved.size, moved.size))
    covariance[np.ix_(used, used)] = variance * inverse / np.outer(moved[used], moved[used])

    # to the units of the record: a = s / half, b = c - a centre, linear ones times the output range
    to_units = np.eye(moved.size)
    for j in range(pairs):
        for slope, place in ((j, pairs + j), (2 * pairs + j, 3 * pairs + j)):
            to_units[slope, slope] = 1 / half
            to_units[place, slope] = -centre / half
    first = parameters.size
    to_units[first:, first:] *= scale
    natural = np.concatenate([arguments[:, :pairs].ravel(), theta, amounts])
    values = to_units @ natural
    values[first + parameters.radii.size] += offset
    covariance = to_units @ covariance @ to_units.T

    # and the memoryless part of the normalised input as one of the input
    bias = first + parameters.radii.size
    own = [*range(first - theta.size, first), *range(bias + 1, values.size), bias]

    def of_the_input(known: FloatArray) -> FloatArray:
        moved, coefficients, constant = parameters.basis.in_units(
            known[theta.size : -1], known[: theta.size], centre, half
        )
        return np.concatenate([moved, coefficients, [known[-1] + constant]])

    change = np.eye(values.size)
    change[np.ix_(own, own)] = _derivatives(of_the_input, values[own])
    values[own] = of_the_input(values[own])
    return _names(projection), values, change @ covariance @ change.T


def _derivatives(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Central differences: exact for what is linear in each argument."""
    columns = []
    for k, value in enumerate(at):
        step = np.zeros(at.size)
        step[k] = 1e-6 * max(abs(float(value)), 1e-6)
        columns.append((function(at + step) - function(at - step)) / (2 * step[k]))
    return np.stack(columns, axis=1)


def _names(projection: Projection) -> tuple[str, ...]:
    parameters = projection.parameters
    pairs, plays = parameters.pairs, parameters.radii.size
    names = []
    for name in ("rising_slope", "rising_offset", "falling_slope", "falling_offset"):
        names += [name] if pairs == 1 else [f"{name}[{j}]" for j in range(pairs)]
    names += [f"memoryless_parameter[{k}]" for k in range(len(parameters.basis.starts[0]))]
    names += [f"weight[{j}]" for j in range(plays)]
    names += ["bias"]
    count = parameters.basis.columns(np.zeros(1), np.array(parameters.basis.starts[0])).shape[1]
    names += [f"memoryless_coefficient[{k}]" for k in range(count)]
    return tuple(names)
