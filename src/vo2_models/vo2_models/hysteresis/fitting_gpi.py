"""Identification of GPI and EGPI models from a recording of input and output.

    minimise  sum_k (y_k - bias - D(v_k) - sum_j p_j F^gamma_{r_j}[v]_k)^2     over p >= 0, bias, D, a_R, b_R, a_L, b_L

with the linear unknowns eliminated (`fitting_projection`), the order of the envelopes kept, and the radii given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from vo2_models.hysteresis.envelopes import TanhEnvelopes
from vo2_models.hysteresis.fitting_memoryless import BASES
from vo2_models.hysteresis.fitting_projection import Parametrisation, Projection
from vo2_models.hysteresis.fitting_start import starting_arguments
from vo2_models.hysteresis.fitting_uncertainty import uncertainties
from vo2_models.hysteresis.prandtl_ishlinskii import EGPI
from vo2_models.validation import finite_array, increasing, nonnegative

__all__ = ["PlayFit", "fit_play_model"]

FloatArray = NDArray[np.float64]

SHRINKAGE = 3e-4
"""Price of moving a play's own envelope one unit from the shared one, as an rms residual over the output range.

Plays that the record hardly moves have no envelope of their own to find; this keeps them where the shared fit put them.
"""

_TRIED, _TRIAL, _FINISHED = 6, 12, 2
"""Starts that are run at all, for how many evaluations, and how many of them are run to the end."""


@dataclass(frozen=True)
class PlayFit:
    """A fitted model and how well the record determines it.

    Attributes
    ----------
    model : EGPI (its memoryless part is Zero for a GPI)
    initial : the saturation the record starts from
    residual : (n,) y minus the model over the samples fitted [output unit]
    rms : root mean square of the residual [output unit]
    nrmse : rms over the range of y in the record
    names, values, std : fitted parameters in the model's own units, and their standard deviations; a weight that
        ends at zero has value and deviation 0 (it is on its bound)
    covariance : (P, P) of `values`
    evaluations : times the model was evaluated with derivatives or without
    """

    model: EGPI
    initial: Literal["lower", "upper"]
    residual: FloatArray
    rms: float
    nrmse: float
    names: tuple[str, ...]
    values: FloatArray
    std: FloatArray
    covariance: FloatArray
    evaluations: int

    def initial_state(self) -> FloatArray:
        """The memory (1 + N,) the record starts from."""
        return self.model.initial_state(self.initial)


def _record(v: ArrayLike, y: ArrayLike, least: int) -> tuple[FloatArray, FloatArray]:
    inputs = finite_array(v, "v")
    outputs = finite_array(y, "y", size=inputs.size)
    if inputs.size < least:
        raise ValueError(f"v: found {inputs.size} samples, need at least {least} for this many parameters")
    for name, array in (("v", inputs), ("y", outputs)):
        if np.ptp(array) <= 0:
            raise ValueError(f"{name}: found a constant signal ({array[0]:g}), need one that varies")
    steps = np.diff(inputs)
    if not (np.any(steps > 0) and np.any(steps < 0)):
        raise ValueError(
            "v: found an input that only rises or only falls, need at least one reversal to see both branches"
        )
    return inputs, outputs


def _radii(radii: ArrayLike | None, plays: int) -> FloatArray:
    if radii is None:
        if int(plays) != plays or plays < 1:
            raise ValueError(f"plays: found {plays}, need a whole number of at least 1")
        return np.arange(int(plays)) / int(plays)
    array = increasing(nonnegative(finite_array(radii, "radii"), "radii"), "radii")
    if array.size == 0 or array[-1] > 1:
        raise ValueError(f"radii: found {array!r}, need some from 0 to 1: a larger tanh play never moves")
    return array


def fit_play_model(
    v: ArrayLike,
    y: ArrayLike,
    *,
    plays: int = 6,
    radii: ArrayLike | None = None,
    memoryless: str = "none",
    per_play: bool = False,
    initial: Literal["auto", "lower", "upper"] = "auto",
    measured: ArrayLike | None = None,
    input_range: tuple[float, float] | None = None,
    max_evaluations: int = 100,
) -> PlayFit:
    """Fit a play model with tanh envelopes to a recording.

    Parameters
    ----------
    v : (n,) inputs in any unit (degC, ampere), with at least one reversal
    y : (n,) outputs in any unit, rising with the input through the hysteresis (weights are not negative; fit
        -log10 R for a resistance that falls)
    plays : N, with radii j / N, j = 0 ... N - 1; or give
    radii : (N,) strictly increasing, 0 to 1
    memoryless : "none", "linear", "rising_linear", "quadratic", "cubic", "tanh", "rising_tanh", "sine"; the
        rising ones keep the model monotone
    per_play : then give each play its own envelopes (Table 7.2), starting from the shared ones
    initial : saturation the record starts from; "auto" takes the one that fits better
    measured : (n,) False where the output is not to be used and only the input matters, such as the first samples where
        the memory at the start is unknown, up to where the input has been through its range once
    input_range : inputs over which the order of the envelopes is kept; None takes those of the record
    max_evaluations : of each least-squares run

    Returns
    -------
    PlayFit

    Raises
    ------
    ValueError : too few samples, constant or one-way signals, radii not as above, an unknown memoryless part.

    Examples
    --------
    >>> import numpy as np
    >>> from vo2_models.hysteresis import GPI, TanhEnvelopes
    >>> device = GPI(np.arange(4) / 4, [1, 0.5, 2, 0.3], TanhEnvelopes(0.3, -19.5, 0.3, -17.5), bias=5.0)
    >>> temperature = 60 + 40 * np.sin(np.linspace(-1.57, 60, 1500)) * np.linspace(1, 0.1, 1500)
    >>> fit = fit_play_model(temperature, device.simulate(temperature)[0], plays=4)
    >>> bool(fit.nrmse < 1e-3), bool(abs(fit.model.envelopes.rising_slope - 0.3) < 0.01)
    (True, True)
    """
    if memoryless not in BASES:
        raise ValueError(f"memoryless: found {memoryless!r}, need one of {', '.join(BASES)}")
    if initial not in ("auto", "lower", "upper"):
        raise ValueError(f"initial: found {initial!r}, need 'auto', 'lower' or 'upper'")
    r = _radii(radii, plays)
    basis = BASES[memoryless]
    parameters = Parametrisation(r, 1, basis)
    unknowns = (4 * r.size if per_play else parameters.size) + r.size + 1
    inputs, outputs = _record(v, y, 2 * unknowns)
    kept = np.ones(inputs.size, dtype=np.bool_) if measured is None else np.asarray(measured, dtype=np.bool_)
    if kept.shape != inputs.shape or np.count_nonzero(kept) < 2 * unknowns:
        raise ValueError(
            f"measured: found shape {kept.shape} with {np.count_nonzero(kept)} True, need {inputs.shape} with "
            f"at least {2 * unknowns}"
        )
    low, high = float(inputs.min()), float(inputs.max())
    if input_range is not None:
        given = finite_array(input_range, "input_range", size=2)
        low, high = min(low, float(given[0])), max(high, float(given[1]))
    centre, half = (low + high) / 2, (high - low) / 2
    offset, scale = float(outputs.mean()), float(np.ptp(outputs))
    z, target = (inputs - centre) / half, (outputs - offset) / scale

    saturations = (True, False) if initial == "auto" else (initial == "lower",)
    x, projection, evaluations = _shared(z, target, parameters, saturations, kept, max_evaluations)
    if per_play:
        x, projection, more = _own_envelopes(
            x, projection, replace(parameters, pairs=r.size), max_evaluations
        )
        evaluations += more
    return _result(projection, x, (centre, half), (offset, scale), (low, high), evaluations)


def _shared(
    z: FloatArray,
    y: FloatArray,
    parameters: Parametrisation,
    saturations: tuple[bool, ...],
    kept: NDArray[np.bool_],
    max_evaluations: int,
) -> tuple[FloatArray, Projection, int]:
    """First stage: one shared pair. Many starts are looked at, some are run a little, the best two to their end."""
    bounds = parameters.bounds()
    runs = []
    for arguments, theta in product(starting_arguments(z[kept], y[kept]), parameters.basis.starts):
        start = np.clip(parameters.pack(arguments, np.array(theta)), *bounds)
        trials = [Projection(z, y, from_below, parameters, kept) for from_below in saturations]
        costs = [float(np.sum(trial.residual(start) ** 2)) for trial in trials]
        runs.append((min(costs), start, trials[int(np.argmin(costs))]))
    evaluations = len(runs) * len(saturations)
    for keep, length in ((_TRIED, _TRIAL), (_FINISHED, max_evaluations)):
        runs.sort(key=lambda run: run[0])
        for k, (_, start, trial) in enumerate(runs[:keep]):
            found = least_squares(
                trial.residual,
                start,
                trial.jacobian,
                bounds,
                x_scale="jac",
                max_nfev=min(length, max_evaluations),
            )
            evaluations += found.nfev + found.njev
            runs[k] = 2 * found.cost, found.x, trial
    _, x, projection = min(runs[:_FINISHED], key=lambda run: run[0])
    return x, projection, evaluations


def _own_envelopes(
    x: FloatArray, shared: Projection, parameters: Parametrisation, max_evaluations: int
) -> tuple[FloatArray, Projection, int]:
    """Second stage: one envelope pair per play, from the shared fit."""
    arguments, theta = shared.parameters.unpack(x)
    projection = Projection(shared.path, shared.record, shared.lower, parameters, shared.kept)
    lower, upper = parameters.bounds()
    start = np.clip(parameters.pack(arguments, theta), lower, upper)
    price = np.zeros(start.size)
    price[: start.size - theta.size] = SHRINKAGE * np.sqrt(shared.z.size)

    def residual(at: FloatArray) -> FloatArray:
        return np.concatenate([projection.residual(at), price * (at - start)])

    def jacobian(at: FloatArray) -> FloatArray:
        return np.concatenate([projection.jacobian(at), np.diag(price)])

    found = least_squares(residual, start, jacobian, (lower, upper), x_scale="jac", max_nfev=max_evaluations)
    return found.x, projection, found.nfev + found.njev


def _result(
    projection: Projection,
    x: FloatArray,
    input_map: tuple[float, float],
    output_map: tuple[float, float],
    input_range: tuple[float, float],
    evaluations: int,
) -> PlayFit:
    """The fit in the units of the record."""
    (centre, half), (offset, scale) = input_map, output_map
    parameters = projection.parameters
    arguments, theta = parameters.unpack(x)
    linear = projection.linear(x)
    slopes = arguments[::2] / half
    offsets = arguments[1::2] - slopes * centre
    numbers = [slopes[0], offsets[0], slopes[1], offsets[1]]
    if parameters.pairs == 1:
        numbers = [number[0] for number in numbers]
    part, constant = parameters.basis.physical(scale * linear.coefficients, theta, centre, half)
    model = EGPI(
        parameters.radii,
        scale * linear.weights,
        TanhEnvelopes(*numbers),
        part,
        offset + scale * linear.bias + constant,
        input_range,
    )
    residual = scale * linear.residual
    rms = float(np.sqrt(np.mean(residual**2)))
    names, values, covariance = uncertainties(projection, x, input_map, output_map)
    return PlayFit(
        model,
        "lower" if projection.lower else "upper",
        residual,
        rms,
        rms / scale,
        names,
        values,
        np.sqrt(np.maximum(np.diag(covariance), 0.0)),
        covariance,
        evaluations,
    )
