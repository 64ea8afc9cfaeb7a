"""Error bounds: what the identification recording says about the errors at each resistance.

The bound is empirical, so it covers whatever the scheme gets wrong (loop shape, noise, rate), as far as
the identification recording showed it; it cannot cover what was never recorded.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from vo2_models.numerics.kernel import kernel
from vo2_models.parameters import Value
from vo2_models.self_sensing.records import BOUND_KNOTS, SECTION
from vo2_models.validation import increasing

__all__ = ["COVERAGE", "bound_table", "fit_bound", "table_at"]

Floats = NDArray[np.float64]

COVERAGE = 0.95
"""Share of the passes by a resistance whose errors lie within the bound, on paths like that of the identification."""


def fit_bound(log_resistance: Floats, error: Floats, knots: Floats) -> Floats:
    """Return what the errors of a pass by each knot stay below with the probability `COVERAGE`.

    Neighbouring samples err together: what is independent is one pass by a resistance, on one branch. The bound is the
    conformal quantile of the passes' largest errors, of `n` passes the `COVERAGE` `(n + 1)`-th smallest (Vovk, Gammerman,
    Shafer, Algorithmic Learning in a Random World, 2005): the next pass stays below it with that probability, and with
    `n / (n + 1)` where there are so few that it is the largest of all.

    Parameters
    ----------
    log_resistance, error : (n,) log10 of the resistance in ohm, and estimation error [m], in the order of recording
    knots : (m,) increasing places

    Returns
    -------
    (m,) [m]; a knot that nothing passes takes the largest bound of the others.
    """
    magnitude = np.abs(error)
    half = np.gradient(knots) if knots.size > 1 else np.full(1, np.inf)
    bound = np.full(knots.size, np.nan)
    for k, place in enumerate(knots):
        near = np.abs(log_resistance - place) <= half[k]
        begins = np.flatnonzero(np.diff(near, prepend=False) & near)
        if begins.size:
            largest = np.sort(np.maximum.reduceat(np.where(near, magnitude, 0.0), begins))
            rank = int(np.ceil(COVERAGE * (largest.size + 1)))
            bound[k] = largest[min(rank, largest.size) - 1]
    return np.where(np.isnan(bound), np.nanmax(bound), bound)


def bound_table(kind: str, parameters: Mapping[str, Value]) -> Floats:
    """Return [knots..., bounds...] (2 m,) of a scheme from flat parameters; one knot with NaN where there is none.

    Parameters
    ----------
    kind : scheme, one of `KINDS`

    Raises
    ------
    ValueError : knots that do not increase.
    """
    knots = np.atleast_1d(np.asarray(parameters.get(BOUND_KNOTS, []), dtype=np.float64))
    bounds = np.atleast_1d(np.asarray(parameters.get(f"{SECTION}.bounds.{kind}", []), dtype=np.float64))
    if knots.size == 0 or bounds.size != knots.size:
        return np.array([0.0, np.nan])
    return np.concatenate([increasing(knots, BOUND_KNOTS), bounds])


@kernel
def table_at(table, x):
    """Linear interpolation in [knots..., values...], constant outside.

    Parameters
    ----------
    table : (2 m,) knots, increasing, then values
    x : where

    Returns
    -------
    float : the value at `x`
    """
    m = table.size // 2
    if x <= table[0]:
        return table[m]
    if x >= table[m - 1]:
        return table[2 * m - 1]
    k = np.searchsorted(table[:m], x) - 1
    share = (x - table[k]) / (table[k + 1] - table[k])
    return table[m + k] + share * (table[m + k + 1] - table[m + k])
