"""Entropy-optimal compression of a play model: fewer plays, the same weight distribution (chapter 3).

A partition cuts the N plays into M groups of neighbours; each group becomes one play at its weighted mean radius with
its total weight, (3.1). What a group loses is

    E_k = T_k sqrt( sum_i (pbar_i (r_i - rhat_k))^2 ) H_k,      pbar_i = p_i / T_k,

its total weight, times the spread of its radii, times the entropy H_k of its normalised weights. (Step 4 of section 3.3
can be read with the root over H_k as well; this reading, on scaled weights with r_j = j / (N + 1), gives the partitions
published for the uniform and the one-peak case, the other does not.) Table 3.4 cannot come from this objective: on (3.16)
the best of all 118 755 partitions loses 0.2909 in sum and 0.0813 at most, the published ones 0.3247 and 0.1472. The
weights behind Table 3.5 were drawn at random and are not published, so that its partitions cannot be checked.
The sum or the largest of the losses is minimised exactly by
dynamic programming, Proposition 1, with O(1) work per group and O(N M) memory.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.prandtl_ishlinskii import PlayModel
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array, increasing, nonnegative

__all__ = ["Compression", "CompressionResult", "compress", "group_loss", "merge", "partition", "scaling"]

FloatArray = NDArray[np.float64]
Criterion = Literal["sum", "max"]


@kernel
def _losses_from(start, radii, weights, losses):
    """losses[end] = E of the group radii[start:end], for every end > start.

    `radii` (N,), `weights` (N,) of at most 1, `losses` (N + 1,) to fill. The group grows by one play at a time. With
    the mean m (weights p) and the centre c (weights p^2) of its radii, and Q = sum p^2,

        sum p^2 (r - m)^2 = sum p^2 (r - c)^2 + Q (m - c)^2,

    and a play of share x of the total takes the entropy from H to (1 - x) H - x ln x - (1 - x) ln(1 - x). Both sums
    only grow, and m - c is followed by itself: a light play beside a heavy one keeps its digits.
    """
    total = 0.0
    squares = 0.0
    mean = 0.0
    centre = 0.0
    apart = 0.0  # m - c
    spread = 0.0  # sum p^2 (r - c)^2
    entropy = 0.0
    for last in range(start, radii.size):
        p = weights[last]
        if p * p > 0.0:  # of less than 1e-162 of the heaviest play nothing would be left
            from_mean = radii[last] - mean
            from_centre = radii[last] - centre
            share_before = total / (total + p)
            square_before = squares / (squares + p * p)
            total += p
            squares += p * p
            share = p / total
            square = p * p / squares
            # the same difference twice: what is small is not to be left over from what is large
            if share > 0.5:
                apart = from_centre * square_before - from_mean * share_before
            else:
                apart += from_mean * share - from_centre * square
            mean += from_mean * share
            centre += from_centre * square
            spread += p * p * square_before * from_centre * from_centre
            small = min(share, share_before)
            if small > 0.0:
                mixed = small * math.log(small) + (1.0 - small) * math.log1p(-small)
                entropy = share_before * entropy - mixed
        losses[last + 1] = math.sqrt(spread + squares * apart * apart) * entropy


@kernel
def _dynamic_programme(radii, weights, groups, largest):
    """Cuts (groups + 1,) of the partition of least total (or least largest) loss, by (3.6)-(3.7) backwards.

    Among equally good cuts (to 1e-12) the first group is the smallest: of the eight partitions that tie in the
    one-peak case under Entropy Max this picks the published one.
    """
    n = radii.size
    value = np.full((groups + 1, n + 1), np.inf)
    choice = np.zeros((groups + 1, n + 1), dtype=np.int32)
    value[0, n] = 0.0
    losses = np.empty(n + 1)
    for start in range(n - 1, -1, -1):
        _losses_from(start, radii, weights, losses)
        for k in range(1, min(groups, n - start) + 1):
            if k == groups and start > 0:
                break
            best = np.inf
            at = n
            for end in range(start + 1, n - k + 2):
                after = value[k - 1, end]
                cost = max(losses[end], after) if largest else losses[end] + after
                if cost < best * (1.0 - 1e-12):
                    best = cost
                    at = end
            value[k, start] = best
            choice[k, start] = at
    cuts = np.zeros(groups + 1, dtype=np.int64)
    for k in range(groups, 0, -1):
        cuts[groups - k + 1] = choice[k, cuts[groups - k]]
    return cuts, value[groups, 0]


def group_loss(radii: ArrayLike, weights: ArrayLike) -> float:
    """Loss E of replacing these plays by one, written from the equation (0 for a single play).

    >>> bool(group_loss([0.0, 1.0], [1.0, 1.0]) == 2 * (2 * 0.25**2) ** 0.5 * np.log(2))
    True

    Parameters
    ----------
    radii, weights : (n,) of the plays, by radius

    Returns
    -------
    float : 0 or more
    """
    r, p = finite_array(radii, "radii"), nonnegative(finite_array(weights, "weights"), "weights")
    total = float(np.sum(p))
    if total == 0:
        return 0.0
    # about the heaviest play, so that a light one beside it keeps its digits
    heaviest = int(np.argmax(p))
    share, r = p / total, r - r[heaviest]
    centre = float(np.sum(share * r))
    others = np.delete(share, heaviest)
    others = others[others > 0]
    rest = float(np.sum(others))
    entropy = -float(np.sum(others * np.log(others))) - (1.0 - rest) * math.log1p(-rest)
    return total * math.sqrt(float(np.sum((share * (r - centre)) ** 2))) * entropy


class CompressionResult(NamedTuple):
    """A partition: `cuts` (M + 1,) indices 0 = beta_0 < ... < beta_M = N, and the criterion's value."""

    cuts: NDArray[np.int64]
    loss: float


def partition(
    radii: ArrayLike, weights: ArrayLike, groups: int, *, criterion: Criterion = "sum"
) -> CompressionResult:
    """Return the optimal partition of a weight distribution, (3.9) or (3.10).

    Parameters
    ----------
    radii : (N,) strictly increasing, >= 0
    weights : (N,) >= 0, scaled or not
    groups : M, 1 to N
    criterion : "sum" (Entropy Sum) or "max" (Entropy Max)

    Raises
    ------
    ValueError : radii or weights not as above, or a number of groups outside 1 to N.

    Examples
    --------
    The one-peak case of Table 3.3:

    >>> j = np.arange(1, 31)
    >>> partition(j / 31, 5 / np.sqrt(2 * np.pi) * np.exp(-((j - 15) ** 2) / 15), 6).cuts.tolist()
    [0, 11, 13, 14, 16, 18, 30]
    """
    r = increasing(nonnegative(finite_array(radii, "radii"), "radii"), "radii")
    p = nonnegative(finite_array(weights, "weights", size=r.size), "weights")
    if int(groups) != groups or not 1 <= groups <= r.size:
        raise ValueError(
            f"groups: found {groups}, need a whole number from 1 to {r.size}, the number of plays"
        )
    if criterion not in ("sum", "max"):
        raise ValueError(f"criterion: found {criterion!r}, need 'sum' or 'max'")
    # squares of weights must neither overflow nor vanish; a power of two changes no digit
    exponent = np.frexp(np.max(p))[1]
    cuts, loss = _dynamic_programme(r, np.ldexp(p, -exponent), int(groups), criterion == "max")
    return CompressionResult(cuts, float(np.ldexp(loss, exponent)))


def scaling(model: PlayModel, radii: ArrayLike, input_range: tuple[float, float]) -> FloatArray:
    """Half the output range of plays of these radii, (gamma_R(v_max) - gamma_L(v_min) - 2 r) / 2, (3.11).

    Not below zero: a play whose radius exceeds what the envelopes span never moves.

    Parameters
    ----------
    model : its envelopes
    input_range : lowest and highest input

    Returns
    -------
    array : (n,) one per play
    """
    low, high = finite_array(input_range, "input_range", size=2)
    if not low < high:
        raise ValueError(f"input_range: found ({low:g}, {high:g}), need lower < upper")
    span = float(model.envelopes.rising(high)) - float(model.envelopes.falling(low))
    return np.maximum(span - 2 * finite_array(radii, "radii"), 0.0) / 2


@dataclass(frozen=True)
class Compression:
    """A compressed model, the partition it came from, and the criterion's value."""

    model: PlayModel
    cuts: NDArray[np.int64]
    loss: float


def compress(
    model: PlayModel,
    plays: int,
    *,
    criterion: Criterion = "sum",
    scaled: bool = True,
    input_range: tuple[float, float] | None = None,
) -> Compression:
    """Return the model with fewer plays that keeps the weight distribution best.

    With scaled weights (3.11) each group keeps the output its plays span together, and the bias takes up the
    shift of the loop's centre that this leaves; envelopes and memoryless part stay.

    Parameters
    ----------
    model : CPI, GPI or EGPI with shared envelopes, strictly increasing radii and weights >= 0
    plays : M, number of plays to keep
    criterion : "sum" (Entropy Sum) or "max" (Entropy Max)
    scaled : weigh each play by the output range it has over the inputs
    input_range : inputs in use, for the scaling; None takes the model's

    Raises
    ------
    ValueError : one envelope pair per play, weights below zero, equal radii, or no input range where one is needed.
    """
    reach = _reach(model, scaled, input_range)
    cuts, loss = partition(model.radii, model.weights * reach, plays, criterion=criterion)
    return Compression(merge(model, cuts, scaled=scaled, input_range=input_range), cuts, loss)


def _reach(model: PlayModel, scaled: bool, input_range: tuple[float, float] | None) -> FloatArray:
    """What the weights are multiplied with before compression: (3.11), or ones."""
    if model.envelopes.plays is not None:
        raise ValueError("model: found one envelope pair per play, need a shared pair to compress")
    if not scaled:
        return np.ones(model.plays)
    limits = input_range if input_range is not None else model.input_range
    if limits is None:
        raise ValueError(
            "input_range: found none, need (low, high) here or in the model to scale the weights"
        )
    return scaling(model, model.radii, limits)


def merge(
    model: PlayModel, cuts: ArrayLike, *, scaled: bool = True, input_range: tuple[float, float] | None = None
) -> PlayModel:
    """Return the model with each group of a partition replaced by one play, as `compress` does for the optimal one.

    Radii and weights are those of (3.1), on scaled weights if asked. The shift of the bias with scaled weights is not the
    dissertation's, whose reduced model keeps the bias: scaled back, the weights no longer add up to the original total, and
    the loop's centre would move by the difference times (gamma_R(v_max) + gamma_L(v_min)) / 2, which the bias takes up. It
    is zero where the envelopes end at -1 and 1.

    Parameters
    ----------
    cuts : (M + 1,) increasing indices 0 = beta_0 < ... < beta_M = N, for instance those of uniform compression
    model, scaled, input_range : see `compress`

    Raises
    ------
    ValueError : cuts not as above, and the reasons of `compress`.
    """
    radii, weights = model.radii, model.weights
    reach = _reach(model, scaled, input_range)
    bounds = increasing(finite_array(cuts, "cuts"), "cuts").astype(np.int64)
    if bounds.size < 2 or bounds[0] != 0 or bounds[-1] != radii.size:
        raise ValueError(f"cuts: found {bounds.tolist()}, need indices from 0 to {radii.size}")
    plays = bounds.size - 1
    limits = input_range if input_range is not None else model.input_range
    new_radii, new_weights = np.empty(plays), np.empty(plays)
    for k, (start, end) in enumerate(pairwise(bounds)):
        group = slice(int(start), int(end))
        share = weights[group] * reach[group]
        total = float(share.sum())
        new_radii[k] = share @ radii[group] / total if total > 0 else radii[group].mean()
        at = float(scaling(model, new_radii[k : k + 1], limits)[0]) if scaled and limits is not None else 1.0
        new_weights[k] = total / at if at > 0 else weights[group].sum()
    bias = model.bias
    if scaled and limits is not None:
        ends = float(model.envelopes.rising(limits[1])) + float(model.envelopes.falling(limits[0]))
        bias += (float(weights.sum()) - float(new_weights.sum())) * ends / 2
    return replace(model, radii=new_radii, weights=new_weights, bias=bias)  # type: ignore[type-var]
