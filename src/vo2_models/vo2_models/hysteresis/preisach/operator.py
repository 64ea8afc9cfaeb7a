"""The Preisach operator with piecewise-constant density: batch, streaming, many devices."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import Inverse, Law, LawInverse, Saturation, check_memory, side_of
from vo2_models.hysteresis.preisach import kernels
from vo2_models.hysteresis.preisach.grid import (
    Diagonal,
    cell_areas,
    checked_walls,
    everett_table,
    pack,
    unpack,
)
from vo2_models.parameters import Value
from vo2_models.validation import finite_array

__all__ = ["PreisachOperator"]

Floats = NDArray[np.float64]

FEWEST_TURNING_POINTS = 200
"""Room of the memory on a coarse grid: a demagnetisation of a hundred cycles. On a fine one it is four per wall."""


@dataclass(frozen=True, eq=False)
class PreisachOperator(Law):
    """u(t) = bias + integral of mu(beta, alpha) gamma_{beta, alpha}[v], relays gamma = +-1: (A.2), (4.1), (5.2).

    The density is constant on each cell of a grid that may be non-uniform; inputs are continuous, so a cell
    may be covered in part, and then counts with the covered area. Outside the grid the operator is
    saturated. The cost of a sample does not depend on the level L. The memory is the stack of turning points that are not
    wiped out yet, laid out as `kernels` says; `history` reads it.

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
    >>> memory = operator.initial_memory()
    >>> operator.step(1.0, memory), operator.step(0.5, memory)
    (-2.0, -2.25)
    """

    name = "preisach"
    move = staticmethod(kernels.move_preisach)
    sweep = staticmethod(kernels.sweep_preisach)
    described: ClassVar = {
        "walls": ("{u}", "increasing input levels of the Preisach grid"),
        "density": ("{y}/{u}^2", "Preisach density of the cells, row by row,"),
        "bias": ("{y}", "constant part"),
    }

    walls: Floats
    density: Floats
    bias: float = 0.0
    diagonal: Diagonal = "triangle"
    compiled: tuple[Floats, Floats, Floats, Floats, float] = field(init=False, repr=False)
    _packed: Floats = field(init=False, repr=False)

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
        uniform = np.allclose(width, width[0], rtol=1e-6, atol=0.0)
        # as many buckets as cells where they are equal, more where not; `kernels.locate` corrects the guess
        starts = np.linspace(walls[0], walls[-1], (1 if uniform else 4) * level, endpoint=False)
        guess = np.searchsorted(walls, starts + 1e-9 * width.min(), side="right") - 1
        buckets = np.clip(guess, 0, level - 1).astype(np.float64)
        scale = buckets.size / (walls[-1] - walls[0])
        table = everett_table(weights)
        packed = np.concatenate([[level, buckets.size, scale], walls, half, buckets, table.ravel()])
        for name, value in (("walls", walls), ("density", density), ("bias", bias), ("_packed", packed)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "compiled", kernels.unpacked(packed))

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

    @property
    def packed(self) -> Floats:
        """The operator as one vector, laid out as `kernels` describes, for other compiled loops."""
        return self._packed

    @property
    def span(self) -> tuple[float, float]:
        """Output in negative and in positive saturation, as `output_range`."""
        return self.output_range

    @property
    def memory_size(self) -> int:
        """Length of the memory of one device."""
        return kernels.HEADER + 2 * max(FEWEST_TURNING_POINTS, 4 * (self.level + 1))

    def initial_memory(self, saturation: Saturation = "lower", *, devices: int | None = None) -> Floats:
        """Return the memory below ("lower") or above ("upper") the grid, (memory_size,) or (devices, memory_size).

        Raises
        ------
        ValueError : another `saturation`, or `devices` below 1.
        """
        side = side_of(saturation)
        if devices is not None and devices < 1:
            raise ValueError(f"devices: found {devices}, need at least 1")
        row = np.zeros(self.memory_size)
        row[:5] = 1.0, self.walls[0], self.output_range[0], self.walls[0], self.output_range[0]
        if side > 0.0:
            kernels.step(self.walls[-1], row, *self.compiled)
        return row if devices is None else np.tile(row, (devices, 1))

    def memory(self, history: ArrayLike) -> Floats:
        """Return the memory (memory_size,) that an input history (n,) leaves, from negative saturation on."""
        found = self.initial_memory()
        self.run(history, found)
        return found

    @staticmethod
    def history(memory: Floats) -> Floats:
        """Return the turning points of a memory and the present input: they lead from negative saturation there."""
        return np.append(memory[kernels.HEADER : kernels.HEADER + 2 * int(memory[0]) : 2], memory[1])

    def present_input(self, memory: Floats) -> float:
        """Input that the memory was last moved to, within the grid."""
        return float(memory[1])

    def step(self, u: float, memory: Floats) -> float:
        """Move one device to the input u and return the output; `memory` (memory_size,) changes in place.

        Raises
        ------
        ValueError : u is NaN, or a memory of the wrong length.
        """
        self._fits(memory)
        output: float = kernels.step(u, memory, *self.compiled)
        if output != output:
            finite_array(u, "u", ndim=0)
        return output

    def step_devices(self, v: ArrayLike, memory: Floats) -> Floats:
        """Apply one input to each device and return the outputs (devices,); `memory` changes in place.

        Raises
        ------
        ValueError : `v` not finite, or not as many as the memory has rows.
        """
        return self.run(finite_array(v, "v")[:, None], memory)[:, 0]

    def run(self, u: ArrayLike, memory: Floats | None = None) -> Floats:
        """Apply inputs and return the outputs, of their shape; `memory` changes in place.

        Parameters
        ----------
        u : (n,) for one device, or (devices, n) with a memory of as many rows
        memory : to start from, None for negative saturation

        Raises
        ------
        ValueError : `u` not finite, or a memory that does not fit it.
        """
        values = finite_array(u, "u", ndim=(1, 2))
        devices = None if values.ndim == 1 else values.shape[0]
        state = self.initial_memory(devices=devices) if memory is None else memory
        check_memory(state)
        if state.shape != (*values.shape[:-1], self.memory_size):
            raise ValueError(
                f"memory: found shape {state.shape}, need {(*values.shape[:-1], self.memory_size)} for these inputs"
            )
        out = np.empty_like(values)
        if values.ndim == 1:
            kernels.run(values, out, state, *self.compiled)
        else:
            kernels.run_devices(values, out, state, *self.compiled)
        return out

    def __call__(self, v: ArrayLike, memory: Floats | None = None) -> Floats:
        """Return the output (n,) or (devices, n) under `v`, from `memory` (not changed) or negative saturation."""
        return self.run(v, None if memory is None else memory.copy())

    def inverse(self, input_range: tuple[float, float] | None = None) -> Inverse:
        """Return the inverse over inputs (low, high), None for the grid: exact where it covers the grid, else by bisection.

        Densities of both signs have the one by bisection, `LawInverse`, too.

        Raises
        ------
        ValueError : an input range that is not in order.
        """
        from vo2_models.hysteresis.preisach.inverse import PreisachInverse

        first, last = float(self.walls[0]), float(self.walls[-1])
        low, high = input_range or (first, last)
        if low <= first and last <= high and not np.any(self.density < 0):
            return PreisachInverse(self)
        return LawInverse(self, (low, high))

    def to_parameters(self, section: str) -> dict[str, Value]:
        """Return the flat parameters; the density row by row, with the true area of the cells on the diagonal."""
        density = pack(self.weights) / pack(cell_areas(self.walls))
        return super().to_parameters(section) | {f"{section}.density": density.tolist()}
