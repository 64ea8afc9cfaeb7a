"""The tangent of the nuisance model, kept in blocks: a loop-shape column is zero outside its own channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vo2_models.numerics.parallel import parallel_map

__all__ = ["Tangent"]

Floats = NDArray[np.float64]
FEW = 8
"""Vectors up to which BLAS is quicker with the long matrix on the right."""


@dataclass(frozen=True)
class Tangent:
    """Whitened (N, k) matrix: columns of each channel's loop shape, of courses in time, then the thermal columns.

    Attributes
    ----------
    blocks : (rows of a channel, (n, k_c) loop columns there); the rows are stacked channel by channel
    thermal : (N, t) columns that reach every channel
    courses : (N, c) of effects whose course in time is free, see `courses`; None for none
    """

    blocks: tuple[tuple[slice, Floats], ...]
    thermal: Floats
    courses: Floats | None = field(default=None)

    @cached_property
    def _dense(self) -> Floats:
        """Columns that reach every channel: courses and thermal ones."""
        return self.thermal if self.courses is None else np.hstack([self.courses, self.thermal])

    @property
    def shape(self) -> tuple[int, int]:
        """(N, k)."""
        return self.thermal.shape[0], self._end + self._dense.shape[1]

    @property
    def _end(self) -> int:
        return sum(block.shape[1] for _, block in self.blocks)

    def _places(self) -> Sequence[tuple[slice, Floats, slice]]:
        found, start = [], 0
        for rows, block in self.blocks:
            found.append((rows, block, slice(start, start + block.shape[1])))
            start += block.shape[1]
        return found

    def gram(self) -> Floats:
        """Return B'B, (k, k)."""
        end, size = self._end, self.shape[1]
        out = np.zeros((size, size))
        out[end:, end:] = self._dense.T @ self._dense
        places = self._places()
        squares = parallel_map(lambda place: place[1].T @ place[1], places)
        for (rows, block, own), square in zip(places, squares, strict=True):
            out[own, own] = square
            cross = block.T @ self._dense[rows]
            out[own, end:] = cross
            out[end:, own] = cross.T
        return out

    def against(self, vectors: Floats) -> Floats:
        """Return B'v for v (N,) or (N, p)."""
        out = np.zeros((self.shape[1], *vectors.shape[1:]))
        for rows, block, own in self._places():
            there = vectors[rows]
            if there.any():  # an effect often leaves a channel as it is
                out[own] = _product(block, there)
        out[self._end :] = np.dot(self._dense.T, vectors)
        return out

    def against_rows(self, rows: slice, vectors: Floats) -> Floats:
        """Return B'v for v that is zero but at the rows of one channel, where it is (n, p)."""
        out = np.zeros((self.shape[1], *vectors.shape[1:]))
        for own_rows, block, own in self._places():
            if own_rows == rows:
                out[own] = block.T @ vectors
        out[self._end :] = self._dense[rows].T @ vectors
        return out

    def times(self, weights: Floats) -> Floats:
        """Return B w for w (k,) or (k, p)."""
        out = self._dense @ weights[self._end :]
        for rows, block, own in self._places():
            out[rows] += block @ weights[own]
        return np.asarray(out)

    def course_weights(self, weights: Floats) -> Floats:
        """Return those of the weights (k,) that are of courses, (c,)."""
        count = 0 if self.courses is None else self.courses.shape[1]
        return weights[self._end : self._end + count]

    def of_courses(self, weights: Floats) -> Floats:
        """Return the part (N,) of B w, w (k,), that is the courses'."""
        if self.courses is None:
            return np.zeros(self.thermal.shape[0])
        return np.asarray(self.courses @ self.course_weights(weights))

    def times_rows(self, rows: slice, weights: Floats) -> Floats:
        """Return the rows of one channel of B w."""
        out = self._dense[rows] @ weights[self._end :]
        for own_rows, block, own in self._places():
            if own_rows == rows:
                out += block @ weights[own]
        return np.asarray(out)

    def restricted(self, keep: NDArray[np.bool_]) -> Tangent:
        """The same with the rows that do not count set to zero."""
        blocks = tuple((rows, block * keep[rows, None]) for rows, block in self.blocks)
        courses = None if self.courses is None else self.courses * keep[:, None]
        return Tangent(blocks, self.thermal * keep[:, None], courses)


def _product(block: Floats, vectors: Floats) -> Floats:
    """Return A'v for A (n, k), v (n,) or (n, p)."""
    # with `dot`, as `@` keeps Python's lock where the result is short; a few vectors are half the work from the left
    if vectors.ndim == 2 and vectors.shape[1] <= FEW:
        return np.asarray(np.dot(vectors.T, block).T)
    return np.asarray(np.dot(block.T, vectors))
