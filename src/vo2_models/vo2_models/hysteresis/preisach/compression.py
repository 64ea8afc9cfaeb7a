"""Optimal compression of a Preisach operator to a coarser grid, chapter 2: exact, by complete enumeration.

Every choice of M - 1 inner walls among those of the original grid is compared. The information lost in any
rectangle of original cells comes from prefix sums beforehand, so that a choice costs a few look-ups and
C(39, 7) = 15.4 million of them a second or so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.preisach.grid import cell_areas
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.numerics.kernel import kernel

__all__ = ["Compression", "Criterion", "compress", "evaluate_partition"]

Floats = NDArray[np.float64]

Criterion = Literal["kl", "sum", "max"]
"""J_KL, J_1 and J_inf of section 2.3."""


@dataclass(frozen=True, eq=False)
class Compression:
    """Result of `compress`.

    Attributes
    ----------
    operator : of level M, each cell with the mean density of what it replaces
    partition : (M + 1,) indices of the kept walls in the original grid
    losses : (M, M) information loss T H of (2.2) to (2.5) of each cell
    cost : the criterion's value
    """

    operator: PreisachOperator
    partition: NDArray[np.int64]
    losses: Floats
    cost: float


def _prefix(cells: Floats) -> Floats:
    sums = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1))
    sums[1:, 1:] = cells.cumsum(0).cumsum(1)
    return sums


def _interval(first: NDArray[np.int64], stop: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the index of the interval of walls [first, stop)."""
    return stop * (stop - 1) // 2 + first


@kernel
def _fill(information, masses, areas, loss, entropy):
    """Fill loss and loss log loss for every rectangle of cells with beta <= alpha, from the prefix sums."""
    level = areas.shape[0] - 1
    for a1 in range(1, level + 1):
        for a0 in range(a1):
            row = a1 * (a1 - 1) // 2 + a0
            for b1 in range(1, a1 + 1):
                for b0 in range(b1):
                    total = masses[a1, b1] - masses[a0, b1] - masses[a1, b0] + masses[a0, b0]
                    extent = areas[a1, b1] - areas[a0, b1] - areas[a1, b0] + areas[a0, b0]
                    if not (total > 0.0 and extent > 0.0):
                        continue
                    inside = (
                        information[a1, b1] - information[a0, b1] - information[a1, b0] + information[a0, b0]
                    )
                    lost = inside - total * np.log(total / extent)
                    if lost > 0.0:  # a divergence is not negative: below is the rounding of the prefix sums
                        column = b1 * (b1 - 1) // 2 + b0
                        loss[row, column] = lost
                        entropy[row, column] = lost * np.log(lost)


def _loss_tables(mass: Floats, area: Floats) -> tuple[Floats, Floats]:
    """Return loss and loss log loss (intervals of alpha, intervals of beta) of every rectangle of cells."""
    level = mass.shape[0]
    density = np.divide(mass, area, out=np.zeros_like(mass), where=area > 0)
    information = mass * np.log(density, out=np.zeros_like(density), where=density > 0)
    loss, entropy = np.zeros((2, level * (level + 1) // 2, level * (level + 1) // 2))
    _fill(_prefix(information), _prefix(mass), _prefix(area), loss, entropy)
    return loss, entropy


@kernel
def _enumerate(loss, entropy, level, target, criterion):
    """Return the best inner walls (depth first, all of them) and how many choices were compared.

    `entropy` is loss log loss; `criterion` 0 is J_KL, 1 the sum, 2 the maximum.
    """
    walls = np.zeros(target + 1, dtype=np.int64)
    walls[target] = level
    best_walls = walls.copy()
    best = np.inf
    sums = np.zeros(target + 1)
    entropies = np.zeros(target + 1)
    largest = np.zeros(target + 1)
    cells = np.log(target * (target + 1) / 2.0)
    compared = 0
    depth = 1
    walls[1] = 0
    while depth > 0:
        # the next place of wall `depth`; the last wall is fixed and adds its row of cells only
        walls[depth] = walls[depth] + 1 if depth < target else level
        if depth < target and walls[depth] > level - (target - depth):
            depth -= 1
            continue
        row = walls[depth] * (walls[depth] - 1) // 2 + walls[depth - 1]
        total = sums[depth - 1]
        entropic = entropies[depth - 1]
        most = largest[depth - 1]
        for j in range(depth):
            column = walls[j + 1] * (walls[j + 1] - 1) // 2 + walls[j]
            here = loss[row, column]
            total += here
            entropic += entropy[row, column]
            most = max(most, here)
        if depth == target:
            compared += 1
            if criterion == 0:
                cost = entropic + total * (cells - np.log(total)) if total > 0.0 else 0.0
            elif criterion == 1:
                cost = total
            else:
                cost = most
            if cost < best:
                best = cost
                best_walls[:] = walls
            depth -= 1
            continue
        # losses only grow with more cells: J_1 and J_inf can stop early
        if (criterion == 1 and total >= best) or (criterion == 2 and most >= best):
            continue
        sums[depth] = total
        entropies[depth] = entropic
        largest[depth] = most
        depth += 1
        if depth < target:
            walls[depth] = walls[depth - 1]
    return best_walls, best, compared


def compress(operator: PreisachOperator, level: int, criterion: Criterion = "kl") -> Compression:
    """Return the operator of the given lower level that loses least information.

    With L_ij the loss of a cell, H their sum and N = M (M + 1) / 2 their number, J_KL = sum L_ij log(N L_ij / H)
    is H times the divergence of the losses from equal shares, J_1 = H, J_inf = max L_ij. J_KL alone does not bound
    the total loss: a choice whose losses are large but equal scores zero.

    Parameters
    ----------
    operator : with density >= 0
    level : M, from 1 to the operator's level
    criterion : "kl", "sum" or "max"

    Raises
    ------
    ValueError : `level` out of range, a negative density, an unknown criterion.

    Examples
    --------
    >>> density = np.zeros((6, 6))
    >>> density[np.tril_indices(6)] = 1.0
    >>> density[4:, 2:4] = 9.0
    >>> compress(PreisachOperator(np.arange(7.0), density), 3, "sum").operator.walls.tolist()
    [0.0, 2.0, 4.0, 6.0]
    """
    mass, area = _checked(operator, level, criterion)
    loss, entropy = _loss_tables(mass, area)
    code = ("kl", "sum", "max").index(criterion)
    partition, _, _ = _enumerate(loss, entropy, operator.level, int(level), code)
    return evaluate_partition(operator, partition, criterion)


def evaluate_partition(
    operator: PreisachOperator, partition: NDArray[np.int64], criterion: Criterion = "kl"
) -> Compression:
    """Return the compression onto given walls, such as the uniform ones of Fig. 2.3.

    Parameters
    ----------
    partition : (M + 1,) increasing indices into the walls, from 0 to L
    operator : to be compressed
    criterion : of the loss

    Raises
    ------
    ValueError : as `compress`, or a partition that does not run from 0 to L.
    """
    kept = np.asarray(partition, dtype=np.int64)
    if (
        kept.ndim != 1
        or kept.size < 2
        or kept[0] != 0
        or kept[-1] != operator.level
        or np.any(np.diff(kept) < 1)
    ):
        raise ValueError(
            f"partition: found {kept.tolist()}, need increasing indices from 0 to {operator.level}"
        )
    mass, area = _checked(operator, kept.size - 1, criterion)
    start = kept[:-1]
    masses = np.add.reduceat(np.add.reduceat(mass, start, axis=0), start, axis=1)
    index = _interval(start, kept[1:])
    losses = np.tril(_loss_tables(mass, area)[0][np.ix_(index, index)])
    total = float(np.sum(losses))
    if criterion == "kl":
        some = losses[losses > 0]
        cells = (kept.size - 1) * kept.size / 2
        cost = float(np.sum(some * np.log(some * cells / total))) if some.size else 0.0
    else:
        cost = total if criterion == "sum" else float(np.max(losses))
    coarse = PreisachOperator.from_weights(operator.walls[kept], masses, operator.bias, operator.diagonal)
    return Compression(coarse, kept, losses, cost)


def _checked(operator: PreisachOperator, level: int, criterion: str) -> tuple[Floats, Floats]:
    if criterion not in ("kl", "sum", "max"):
        raise ValueError(f"criterion: found {criterion!r}, need 'kl', 'sum' or 'max'")
    if level != int(level) or not 1 <= level <= operator.level:
        raise ValueError(
            f"level: found {level}, need a whole number from 1 to the operator's level {operator.level}"
        )
    if np.any(operator.density < 0):
        raise ValueError(f"operator: found density {operator.density.min():g}, need densities >= 0")
    return operator.weights, cell_areas(operator.walls, operator.diagonal)
