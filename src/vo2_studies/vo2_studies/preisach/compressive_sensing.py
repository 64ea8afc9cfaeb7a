"""Identification from fewer measurements than unknowns by compressive sensing, section 4.2.

The outputs b = S w of the whole excitation are sparse after a discrete cosine transform; the coefficients of
least l1 norm that agree with the measured outputs are found, and w follows from the outputs they imply. S
may be that of any model linear in its unknowns: Preisach densities, or the weights of a play model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, sparse
from scipy.fft import idct
from vo2_models.hysteresis.preisach.damped import inverse_map
from vo2_models.hysteresis.preisach.grid import Diagonal, cell_areas, cell_count, checked_walls, pack
from vo2_models.hysteresis.preisach.least_squares import fit_preisach
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.validation import finite_array

from vo2_studies.preisach.basis_pursuit import basis_pursuit

__all__ = [
    "CompressedIdentification",
    "identify_compressed",
    "identify_preisach_compressed",
    "recover_outputs",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CompressedIdentification:
    """What compressive sensing found.

    Attributes
    ----------
    parameters : (N,) unknowns w
    outputs : (n,) outputs of the whole excitation, as implied by the coefficients
    coefficients : (n,) their cosine coefficients q, or q_order
    gap : how far the l1 norm can be above its minimum, relative
    """

    parameters: Floats
    outputs: Floats
    coefficients: Floats
    gap: float


@lru_cache(maxsize=4)
def _cosines(n: int) -> Floats:
    """Return the inverse of the orthonormal DCT-II as a matrix: outputs = cosines @ coefficients."""
    matrix: Floats = idct(np.eye(n), axis=0, norm="ortho")
    matrix.setflags(write=False)
    return matrix


def recover_outputs(
    measured: Floats,
    rows: NDArray[np.intp],
    count: int,
    *,
    order: NDArray[np.intp] | None = None,
    noise: float = 0.0,
) -> tuple[Floats, Floats, float]:
    """Return outputs (count,), coefficients and duality gap from the outputs measured at `rows`: (4.14), (4.15).

    Parameters
    ----------
    order : (count,) order in which the outputs are smooth, None for theirs
    noise : norm of the measurement noise [output unit]
    """
    place = rows
    if order is not None:
        place = np.empty(count, dtype=np.intp)
        place[order] = np.arange(count)
        place = place[rows]
    cosines = _cosines(count)
    pursuit = basis_pursuit(np.ascontiguousarray(cosines[place]), measured, noise=noise)
    outputs = cosines @ pursuit.solution
    if order is not None:
        ranked, outputs = outputs, np.empty(count)
        outputs[order] = ranked
    return outputs, pursuit.solution, pursuit.gap


def identify_compressed(
    measured: ArrayLike,
    rows: ArrayLike,
    matrix: Floats,
    *,
    order: ArrayLike | None = None,
    nonnegative: ArrayLike | None = None,
    noise: float = 0.0,
) -> CompressedIdentification:
    """Identify w from a part of the outputs of `matrix @ w`.

    Parameters
    ----------
    measured : (m,) outputs at the samples `rows`
    rows : (m,) distinct indices into the n samples of the excitation
    matrix : (n, N) signed areas, or play outputs. Where it is not regular, the Moore-Penrose pseudoinverse
        takes the place of the inverse in (4.13).
    order : (n,) samples in ascending order of their *true, unmeasured* outputs: an oracle ("CS Order")
    nonnegative : (N,) True for the unknowns that must not be negative, (4.16) ("... Non-negative")
    noise : bound on the Euclidean norm of the measurement noise; 0 is the dissertation's equality

    Returns
    -------
    CompressedIdentification : unknowns, outputs of the whole excitation, coefficients and gap

    Raises
    ------
    ValueError : indices repeated or out of range, shapes that do not fit, `order` no permutation.
    """
    areas = finite_array(matrix, "matrix", ndim=2)
    y, place, ranking = _checked(measured, rows, order, areas.shape[0])
    outputs, coefficients, gap = recover_outputs(y, place, areas.shape[0], order=ranking, noise=noise)
    if nonnegative is None:
        parameters = np.asarray(np.linalg.lstsq(areas, outputs, rcond=1e-12)[0], dtype=np.float64)
    else:
        bounded = np.asarray(nonnegative, dtype=np.bool_)
        if bounded.shape != areas.shape[1:]:
            raise ValueError(
                f"nonnegative: found shape {bounded.shape}, need {areas.shape[1:]} as matrix has columns"
            )
        wide = optimize.nnls(np.hstack([areas, -areas[:, ~bounded]]), outputs)[0]
        parameters = wide[: bounded.size].copy()
        parameters[~bounded] -= wide[bounded.size :]
    return CompressedIdentification(parameters, outputs, coefficients, gap)


def identify_preisach_compressed(
    measured: ArrayLike,
    rows: ArrayLike,
    walls: ArrayLike,
    *,
    order: ArrayLike | None = None,
    nonnegative: bool = False,
    noise: float = 0.0,
    diagonal: Diagonal = "triangle",
) -> tuple[PreisachOperator, CompressedIdentification]:
    """Identify a Preisach operator from a part of the outputs of `excitation.damped_oscillation(walls)`.

    As `identify_compressed`, with the sparse inverse of S in place of a dense one.

    Parameters
    ----------
    order : order in which the outputs are smooth, None for theirs
    noise : norm of the measurement noise [output unit]
    diagonal : what the cells on the diagonal are

    Returns
    -------
    tuple : operator and identification

    Raises
    ------
    ValueError : as `identify_compressed`.

    Examples
    --------
    >>> walls = np.arange(11.0)
    >>> truth = PreisachOperator(walls, np.ones(55))
    >>> b = truth(damped_oscillation(walls))
    >>> rows = np.delete(np.arange(56), [7, 20, 33])  # three outputs not measured
    >>> found, _ = identify_preisach_compressed(b[rows], rows, walls, nonnegative=True)
    >>> bool(np.max(np.abs(found(damped_oscillation(walls)) - b)) < 0.05 * np.ptp(b))
    True
    """
    grid = checked_walls(walls)
    cells = cell_count(grid.size - 1)
    y, place, ranking = _checked(measured, rows, order, cells + 1)
    outputs, coefficients, gap = recover_outputs(y, place, cells + 1, order=ranking, noise=noise)
    if nonnegative:
        operator = fit_preisach(damped_oscillation(grid), outputs, grid, diagonal=diagonal).operator
    else:
        scale = sparse.diags_array(np.append(1.0 / pack(cell_areas(grid, diagonal)), 1.0))
        w = scale @ (inverse_map(grid.size - 1) @ outputs)
        operator = PreisachOperator(grid, w[:cells], float(w[cells]), diagonal)
    return operator, CompressedIdentification(operator.parameters, outputs, coefficients, gap)


def _checked(
    measured: ArrayLike, rows: ArrayLike, order: ArrayLike | None, count: int
) -> tuple[Floats, NDArray[np.intp], NDArray[np.intp] | None]:
    place = np.asarray(rows)
    if place.ndim != 1 or place.size == 0 or not np.issubdtype(place.dtype, np.integer):
        raise ValueError(
            f"rows: found {place.dtype} of shape {place.shape}, need at least one integer index (m,)"
        )
    if place.min() < 0 or place.max() >= count or np.unique(place).size != place.size:
        raise ValueError(
            f"rows: found {place.size} indices from {place.min()} to {place.max()}, {np.unique(place).size} of them "
            f"distinct, need distinct ones from 0 to {count - 1}"
        )
    y = finite_array(measured, "measured", size=place.size)
    if order is None:
        return y, place.astype(np.intp), None
    ranking = np.asarray(order)
    if ranking.shape != (count,) or not np.array_equal(np.sort(ranking), np.arange(count)):
        raise ValueError(f"order: found shape {ranking.shape}, need a permutation of 0 to {count - 1}")
    return y, place.astype(np.intp), ranking.astype(np.intp)
