"""The Preisach operator with piecewise-constant density: batch, streaming, many devices."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.preisach import kernels
from vo2_models.hysteresis.preisach.grid import (
    Diagonal,
    cell_areas,
    checked_walls,
    everett_table,
    pack,
    unpack,
)
from vo2_models.hysteresis.preisach.memory import PreisachState
from vo2_models.validation import finite_array

__all__ = ["PreisachOperator"]

Floats = NDArray[np.float64]

_FIRST_TURNING_POINTS = 30


@dataclass(frozen=True, eq=False)
class PreisachOperator:
    """u(t) = bias + integral of mu(beta, alpha) gamma_{beta, alpha}[v](t), relays gamma = +-1: (A.2), (4.1), (5.2).

    The density is constant on each cell of a grid that may be non-uniform; inputs are continuous, so a cell
    may be covered in part, and then counts with the covered area. Outside the grid the operator is
    saturated. The cost of a sample does not depend on the level L.

    Parameters
    ----------
    walls : (L + 1,) increasing input levels [input unit], the same for both thresholds
    density : (L, L) with row = cell of alpha, column = cell of beta, zero above the diagonal; or packed
        (L (L + 1) / 2,) row by row. [output unit / input unit^2]. May be signed.
    bias : constant part of the output, mu_0 of (4.2), u_c of (A.3)
    diagonal : "triangle", the true area of the cells on the diagonal, or "square", which counts them like
        the others (the convention of chapter 4; the same as doubling their density)

    Raises
    ------
    ValueError : walls not increasing, shapes that do not fit, a density above the diagonal, not finite.

    Examples
    --------
    >>> operator = PreisachOperator([0.0, 1.0, 2.0], [[1.0, 0.0], [2.0, 1.0]])
    >>> operator([0.0, 2.0, 1.0, 1.5, 2.0]).tolist()
    [-3.0, 3.0, 2.0, 2.25, 3.0]
    >>> state = operator.saturated()
    >>> operator.update(1.0, state), operator.update(0.5, state)
    (-2.0, -2.25)
    """

    walls: Floats
    density: Floats
    bias: float = 0.0
    diagonal: Diagonal = "triangle"
    compiled: tuple[Floats, Floats, Floats, NDArray[np.int64], float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # copies: the compiled tables must not fall behind an array that the caller changes later
        walls = checked_walls(self.walls).copy()
        level = walls.size - 1
        density = finite_array(self.density, "density", ndim=(1, 2))
        density = unpack(density) if density.ndim == 1 else density.copy()
        if density.shape != (level, level):
            raise ValueError(
                f"density: found level {density.shape}, need {(level, level)} for {walls.size} walls"
            )
        if np.any(np.triu(density, 1)):
            i, j = (int(k) for k in np.argwhere(np.triu(density, 1))[0])
            raise ValueError(
                f"density: found {density[i, j]:g} at {(i, j)}, need 0 above the diagonal (beta > alpha)"
            )
        bias = float(finite_array(self.bias, "bias", ndim=0))
        weights = density * cell_areas(walls, self.diagonal)
        width = np.diff(walls)
        half = np.ascontiguousarray(np.diag(weights) / width**2)
        uniform = np.allclose(width, width[0], rtol=1e-6)
        # as many buckets as cells where they are equal, more where not; `kernels.locate` corrects the guess
        starts = np.linspace(walls[0], walls[-1], (1 if uniform else 4) * level, endpoint=False)
        guess = np.searchsorted(walls, starts + 1e-9 * width.min(), side="right") - 1
        buckets = np.clip(guess, 0, level - 1).astype(np.int64)
        scale = float(buckets.size / (walls[-1] - walls[0]))
        for name, value in (("walls", walls), ("density", density), ("bias", bias)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "compiled", (everett_table(weights), walls, half, buckets, scale))

    @classmethod
    def from_weights(
        cls, walls: ArrayLike, weights: ArrayLike, bias: float = 0.0, diagonal: Diagonal = "triangle"
    ) -> PreisachOperator:
        """Return the operator whose cells have these integrals of the density, (L, L) or packed."""
        checked = checked_walls(walls)
        cells = finite_array(weights, "weights", ndim=(1, 2))
        cells = unpack(cells) if cells.ndim == 1 else cells
        if cells.shape != (checked.size - 1,) * 2:
            raise ValueError(f"weights: found {cells.shape}, need {(checked.size - 1,) * 2}")
        areas = cell_areas(checked, diagonal)
        return cls(checked, np.divide(cells, areas, out=cells.copy(), where=areas > 0), bias, diagonal)

    @property
    def level(self) -> int:
        """Discretisation level L."""
        return self.walls.size - 1

    @cached_property
    def weights(self) -> Floats:
        """Integral of the density over each cell (L, L) [output unit]."""
        return np.asarray(self.density * cell_areas(self.walls, self.diagonal), dtype=np.float64)

    @property
    def parameters(self) -> Floats:
        """Packed density and bias (L (L + 1) / 2 + 1,): the vector w of (4.3)."""
        return np.append(pack(self.density), self.bias)

    @property
    def output_range(self) -> tuple[float, float]:
        """Output in negative and in positive saturation."""
        total = float(self.compiled[0][-1, 0])
        return self.bias - total, self.bias + total

    def saturated(self, sign: int = -1, *, devices: int | None = None) -> PreisachState:
        """Return the memory after saturation (-1 below the grid, +1 above), of one or several devices.

        Raises
        ------
        ValueError : `sign` is neither -1 nor +1, or `devices` below 1.
        """
        if sign not in (-1, 1):
            raise ValueError(f"sign: found {sign!r}, need -1 or +1")
        if devices is not None and devices < 1:
            raise ValueError(f"devices: found {devices}, need at least 1")
        row = np.zeros(kernels.HEADER + 2 * _FIRST_TURNING_POINTS)
        row[:5] = 1.0, self.walls[0], self.output_range[0], self.walls[0], self.output_range[0]
        if sign == 1:
            kernels.step(self.walls[-1], row, *self.compiled)
        return PreisachState(row if devices is None else np.tile(row, (devices, 1)))

    def memory(self, history: ArrayLike) -> PreisachState:
        """Return the memory that an input history (n,) leaves, from negative saturation on."""
        return self.run(history, self.saturated())[1]

    def update(self, v: float, state: PreisachState) -> float:
        """Apply one input to one device and return the output; `state` changes in place.

        Raises
        ------
        ValueError : `v` is NaN, or the state holds several devices.
        """
        array = state.array
        if array.ndim != 1:
            raise ValueError(f"state: found {len(array)} devices, need one; see update_devices")
        u = kernels.step(float(v), array, *self.compiled)
        if u != u:
            if v != v:
                raise ValueError("v: found nan, need a number; hold the last input or skip the sample")
            state.enlarge()
            return self.update(v, state)
        return u

    def update_devices(self, v: ArrayLike, state: PreisachState) -> Floats:
        """Apply one input to each device and return the outputs (devices,); `state` changes in place.

        Raises
        ------
        ValueError : `v` not finite, or not as many as the state has devices.
        """
        return self.run(finite_array(v, "v")[:, None], state)[0][:, 0]

    def run(self, v: ArrayLike, state: PreisachState) -> tuple[Floats, PreisachState]:
        """Apply an input sequence and return the outputs and the state, which changes in place.

        Parameters
        ----------
        v : (n,) for one device, or (devices, n) with a state of as many devices
        state : the memory to start from

        Raises
        ------
        ValueError : `v` not finite, or its shape does not fit the state.
        """
        values = finite_array(v, "v", ndim=(1, 2))
        if values.shape[:-1] != state.array.shape[:-1]:
            raise ValueError(
                f"v: found shape {values.shape}, need {(*state.array.shape[:-1], 'n')} as the state has"
            )
        out = np.empty_like(values)
        if values.ndim == 1:
            done = kernels.run(values, out, 0, state.array, *self.compiled)
            while done < values.size:
                state.enlarge()
                done = kernels.run(values, out, done, state.array, *self.compiled)
        else:
            reached = np.zeros(values.shape[0], dtype=np.int64)
            while not kernels.run_devices(values, out, reached, state.array, *self.compiled):
                state.enlarge()
        return out, state

    def __call__(self, v: ArrayLike, state: PreisachState | None = None) -> Floats:
        """Return the output (n,) or (devices, n) under `v`, from `state` (not changed) or negative saturation."""
        values = finite_array(v, "v", ndim=(1, 2))
        devices = None if values.ndim == 1 else values.shape[0]
        return self.run(values, self.saturated(devices=devices) if state is None else state.copy())[0]
