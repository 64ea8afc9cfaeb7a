"""A linear basis of smooth hysteresis corrections, for what a fitted loop shape gets wrong.

Any ensemble of switching domains is a Preisach operator (A.1), so what an EGPI leaves over of the loop's
shape is, to first order, one too: a smooth density on the Preisach plane, in the coordinates
c = (alpha + beta) / 2 and r = (alpha - beta) / 2 where domains crowd. Seven groups of basis functions span
the correction of one channel:

    correction(t) = sum_b w_b P_b[T](t)                      density, cubic B-splines in (c, r)
                  + sum_b v_b (T - T_c) / T_w  Q_b[T](t)      contrast of the phases that changes with T
                  + sum_b u_b x(t) Q_b[T](t)                  mixing law: a domain counts by the fraction x it meets
                  + sum_k m_k B_k(T)                          both plateaus
                  + sum_a q_a C_a[T](t)                       scatter of a finite number of domains
                  + sum_d l_d D_d[T](t)                       loops that do not close, where `local` has them

P_b is the output of the hysterons of density b, on = 1, off = 0, from cold saturation. It is summed from
Everett functions, whose table holds all basis functions side by side: a sample costs one table look-up per
basis function, whatever the memory's depth. C_a are the cells of `rough`, D_d the elements of `local_memory`. Every
column is scaled by the standard deviation its weight is given beforehand, so the prior of the weights is the unit normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.identification.local_memory import FadingLags, LimitingLoops, LocalMemory
from vo2_models.identification.rough import cell_features, cell_sum
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array, positive_number

__all__ = ["LOCAL", "Correction", "EnrichmentBasis", "everett_table", "preisach_features"]

Floats = NDArray[np.float64]
DEEPEST = 512
"""Turning points remembered; deeper ones are merged, which only a signal of that many nested loops notices."""
WANDERING, LIMITING, FADING = "wandering", "limiting", "fading"
LOCAL = (WANDERING, LIMITING, FADING)
"""Kinds of local memory, see `local_memory`."""
PIECE = 128
"""Samples whose columns are written together."""


def cubic_spline(knots: Floats, x: Floats) -> Floats:
    """Values of the uniform cubic B-splines centred at `knots` (m,): shape of x with (m,) appended."""
    u = np.abs((np.asarray(x)[..., None] - knots) / (knots[1] - knots[0]))
    v = np.maximum(2.0 - u, 0.0)
    return np.where(u < 1, 2 / 3 - u * u * (1.0 - 0.5 * u), v * v * v / 6)


def everett_table(centre: Floats, half_width: Floats, walls: Floats) -> Floats:
    """Everett functions of B-spline densities on a grid of walls.

    Parameters
    ----------
    centre, half_width : (p,), (q,) uniform knots of the density in c and r [K, degC]
    walls : (g,) uniform temperatures [degC]

    Returns
    -------
    (g, g, p q) : element (i, j) is the density's integral over walls[j] <= beta <= alpha <= walls[i], [K^2];
        zero where i <= j
    """
    step = walls[1] - walls[0]
    mid = 0.5 * (walls[1:] + walls[:-1])
    alpha, beta = np.meshgrid(mid, mid, indexing="ij")
    c, r = 0.5 * (alpha + beta), 0.5 * (alpha - beta)
    density = cubic_spline(centre, c)[..., :, None] * cubic_spline(half_width, r)[..., None, :]
    density = density.reshape(mid.size, mid.size, -1)
    area = step**2 * np.where(r > 1e-9, 1.0, np.where(r < -1e-9, 0.0, 0.5))
    mass = np.cumsum(density * area[..., None], axis=0)
    table = np.zeros((walls.size, walls.size, density.shape[2]))
    table[1:, :-1] = np.cumsum(mass[:, ::-1], axis=1)[:, ::-1]
    return table


@kernel(nogil=True)
def _features_kernel(temperature, low, step, table, out):
    size, _, m = table.shape
    turns = np.zeros(DEEPEST)
    held = np.zeros((DEEPEST, m))
    depth = 1  # turns[0] is cold saturation, then maximum, minimum, maximum ...
    last = 0.0
    for k in range(temperature.size):
        x = min(max((temperature[k] - low) / step, 0.0), size - 1.0)
        if x > last:
            if depth % 2 == 0:  # was falling: `last` is a new minimum
                if depth < DEEPEST - 1:
                    turns[depth] = last
                    held[depth] = out[k - 1]
                    depth += 1
                else:
                    depth -= 1
            while depth >= 3 and x >= turns[depth - 2]:
                depth -= 2
        elif x < last:
            if depth % 2 == 1:  # was rising: `last` is a new maximum
                if depth < DEEPEST - 1:
                    turns[depth] = last
                    held[depth] = out[k - 1]
                    depth += 1
                else:
                    depth -= 1
            while depth >= 3 and x <= turns[depth - 2]:
                depth -= 2
            if depth == 2 and x <= turns[0]:
                depth = 1
        elif k > 0:
            out[k] = out[k - 1]
            continue
        turn = turns[depth - 1]
        rising = depth % 2 == 1
        upper = x if rising else turn
        lower = turn if rising else x
        sign = 1.0 if rising else -1.0
        i = min(int(upper), size - 2)
        j = min(int(lower), size - 2)
        f = upper - i
        g = lower - j
        w00 = (1 - f) * (1 - g) * sign
        w10 = f * (1 - g) * sign
        w01 = (1 - f) * g * sign
        w11 = f * g * sign
        for b in range(m):
            out[k, b] = (
                held[depth - 1, b]
                + w00 * table[i, j, b]
                + w10 * table[i + 1, j, b]
                + w01 * table[i, j + 1, b]
                + w11 * table[i + 1, j + 1, b]
            )
        last = x


def preisach_features(temperature: ArrayLike, walls: Floats, table: Floats) -> Floats:
    """Outputs of several Preisach operators on one input, from cold saturation.

    Parameters
    ----------
    temperature : (n,) input [degC]
    walls, table : grid and Everett functions as of `everett_table`

    Returns
    -------
    (n, m) : one column per basis function, 0 at cold saturation
    """
    path = finite_array(temperature, "temperature")
    out = np.zeros((path.size, table.shape[2]))
    _features_kernel(path, float(walls[0]), float(walls[1] - walls[0]), table, out)
    return out


@dataclass(frozen=True)
class EnrichmentBasis:
    """Where corrections may be, how finely, and how large they are expected to be.

    Attributes
    ----------
    centre_degc : (lowest, highest) c of the density [degC]
    half_width_k : largest r of the density [K]
    temperature_degc : (lowest, highest) of the memoryless part [degC]
    centre_step_k, half_width_step_k, temperature_step_k : knot spacing [K]
    coarse_step_k : knot spacing of contrast and mixing law in c and r [K]
    density_share, contrast_share, mixing_share, memoryless_share : prior standard deviations of the weights,
        as shares of the channel's range; the densities per unit B-spline (2/3 per K^2 at its knot)
    domains : number of domains whose scatter the cells stand for
    cell_k : size of a cell [K]
    grid_k : spacing of the Everett table [K]
    typical_centre, typical_half_width : mean and standard deviation [degC, K] of c and r of a typical device,
        which make the fraction x of the mixing term, and place the elements of local memory
    local : kinds of local memory that the loops may have, of `LOCAL`; a film of independent domains has none
    local_share : prior standard deviation of an element's weight, as a share of the channel's range
    """

    centre_degc: tuple[float, float] = (46.0, 76.0)
    half_width_k: float = 8.0
    temperature_degc: tuple[float, float] = (20.0, 100.0)
    centre_step_k: float = 1.5
    half_width_step_k: float = 1.0
    temperature_step_k: float = 4.0
    coarse_step_k: tuple[float, float] = (4.0, 2.0)
    density_share: float = 0.02
    contrast_share: float = 0.005
    mixing_share: float = 0.01
    memoryless_share: float = 0.3
    domains: float = 4000.0
    cell_k: float = 1.0
    grid_k: float = 0.5
    typical_centre: tuple[float, float] = (58.5, 3.6)
    typical_half_width: tuple[float, float] = (3.5, 1.0)
    local: tuple[str, ...] = ()
    local_share: float = 0.05

    def __post_init__(self) -> None:
        for name in ("half_width_k", "centre_step_k", "half_width_step_k", "temperature_step_k", "grid_k"):
            positive_number(getattr(self, name), name)

    def over(self, low: float, high: float) -> EnrichmentBasis:
        """Return the same basis stretched over another range of centres, low to high [degC], with as many functions.

        The prior stays: a density per K^2 is the smaller the more K^2 there are.

        Parameters
        ----------
        low, high : ends of that range [degC], low < high
        """
        by = (high - low) / (self.centre_degc[1] - self.centre_degc[0])
        return replace(
            self,
            centre_degc=(low, high),
            half_width_k=by * self.half_width_k,
            centre_step_k=by * self.centre_step_k,
            half_width_step_k=by * self.half_width_step_k,
            temperature_step_k=by * self.temperature_step_k,
            coarse_step_k=(by * self.coarse_step_k[0], by * self.coarse_step_k[1]),
            density_share=self.density_share / by**2,
            contrast_share=self.contrast_share / by**2,
            mixing_share=self.mixing_share / by**2,
            cell_k=by * self.cell_k,
            grid_k=by * self.grid_k,
        )

    def _knots(self) -> tuple[Floats, Floats]:
        low, high = self.centre_degc
        return (
            np.arange(low, high + 0.5 * self.centre_step_k, self.centre_step_k),
            np.arange(0.0, self.half_width_k + 0.5 * self.half_width_step_k, self.half_width_step_k),
        )

    def _coarse_knots(self) -> tuple[Floats, Floats]:
        low, high = self.centre_degc
        centre, half_width = self.coarse_step_k
        return (
            np.arange(low, high + 0.5 * centre, centre),
            np.arange(0.25 * half_width, self.half_width_k, half_width),
        )

    @property
    def columns(self) -> int:
        """Number of columns of `features`."""
        return max(columns.stop for columns in self.groups.values())

    @property
    def groups(self) -> dict[str, slice]:
        """Columns of each group, in order."""
        fine, coarse, memoryless = self._sizes()
        sizes = {
            "density": fine, "contrast": coarse, "mixing": coarse, "memoryless": memoryless,
            "scatter": self._cells()[1].size,
            **{kind: self._elements(kind).size for kind in self.local},
        }  # fmt: skip
        ends = np.cumsum(list(sizes.values()))
        return {
            name: slice(int(end) - size, int(end))
            for (name, size), end in zip(sizes.items(), ends, strict=True)
        }

    def _elements(self, kind: str) -> LocalMemory | LimitingLoops | FadingLags:
        """Elements of local memory: over the centres, half widths and spreads that films of this kind have."""
        (mean, spread), (half, _) = self.typical_centre, self.typical_half_width
        centres = tuple((mean + spread * np.linspace(-2.4, 2.4, 7)).tolist())
        if kind in (LIMITING, FADING):
            elements = LimitingLoops if kind == LIMITING else FadingLags
            return elements(centres, tuple(share * half for share in (0.5, 1.0, 1.5)), (0.35 * spread,))
        half_widths = tuple(share * half for share in (0.3, 0.8, 1.2, 1.7))
        return LocalMemory(centres, half_widths, (0.2 * spread, 0.45 * spread))

    def _cells(self) -> tuple[tuple[int, int], NDArray[np.int64], Floats, float]:
        """Shape of the grid of cells, the ones in use, the expected share of each, and the lowest alpha."""
        (mean, spread), (half, half_spread) = self.typical_centre, self.typical_half_width
        # a domain's heating temperature is c + r; the structural transition scatters further
        heating, wide = mean + half, 1.3 * np.hypot(spread, half_spread)
        low = np.floor(heating - 4.0 * wide)
        alpha = np.arange(low, heating + 4.0 * wide, self.cell_k) + 0.5 * self.cell_k
        # a loop that is narrower than a cell has one width, however unlikely
        width = np.arange(1, max(int(2 * (half + 4.0 * half_spread) / self.cell_k), 1) + 1) * self.cell_k
        exponent = np.add.outer(
            -0.5 * ((alpha - heating) / wide) ** 2, -0.5 * ((width - 2 * half) / (2.4 * half_spread)) ** 2
        ).ravel()
        share = np.exp(exponent - np.max(exponent))
        share /= share.sum()
        chosen = np.flatnonzero(share > 1e-3 * share.max())
        return (alpha.size, width.size), chosen, share[chosen], float(low)

    def _sizes(self) -> tuple[int, int, int]:
        fine, coarse = (a.size * b.size for a, b in (self._knots(), self._coarse_knots()))
        return fine, coarse, self._memoryless_knots().size

    def _memoryless_knots(self) -> Floats:
        step = self.temperature_step_k
        return np.arange(self.temperature_degc[0] - step, self.temperature_degc[1] + 1.5 * step, step)

    def features(self, temperature: ArrayLike, *, span: float) -> Floats:
        """Columns of the correction of one channel, scaled so that every weight is unit normal beforehand.

        Parameters
        ----------
        temperature : (n,) what drives the transition, from a cold rest [degC]
        span : range of the channel, in its unit

        Returns
        -------
        (n, columns), in the channel's unit
        """
        path = finite_array(temperature, "temperature")
        walls, table = _tables(replace(self, domains=1.0, local=()))
        raw = preisach_features(path, walls, table)
        fine, coarse, _ = self._sizes()
        p, q, x = raw[:, :fine], raw[:, fine : fine + coarse], raw[:, -1:]
        low, high = self.centre_degc
        warmth = ((path - 0.5 * (low + high)) / (0.5 * (high - low)))[:, None]
        shape, chosen, share, lowest = self._cells()
        cells = cell_features(path, low=lowest, step=self.cell_k, shape=shape, chosen=chosen)
        plateau = cubic_spline(self._memoryless_knots(), path)
        spread = np.sqrt(share / self.domains)
        groups = self.groups
        local = {kind: self._elements(kind).features(path) for kind in self.local}
        out = np.empty((path.size, self.columns))
        # piece by piece: a recording's columns are larger than the processor's cache
        for first in range(0, path.size, PIECE):
            rows = slice(first, first + PIECE)
            piece = out[rows]
            np.multiply(self.density_share, p[rows], out=piece[:, groups["density"]])
            np.multiply(self.contrast_share * warmth[rows], q[rows], out=piece[:, groups["contrast"]])
            np.multiply(self.mixing_share * x[rows], q[rows], out=piece[:, groups["mixing"]])
            np.multiply(self.memoryless_share, plateau[rows], out=piece[:, groups["memoryless"]])
            np.multiply(cells[rows], spread, out=piece[:, groups["scatter"]])
            for kind, fractions in local.items():
                np.multiply(self.local_share, fractions[rows], out=piece[:, groups[kind]])
            piece *= span
        return out

    def fold(self, weights: Floats, *, span: float) -> Correction:
        """Return `T -> features(T, span=span) @ weights` at the cost of a few basis functions."""
        w = finite_array(weights, "weights", size=self.columns)
        walls, table = _tables(replace(self, domains=1.0, local=()))
        density, contrast, mixing, memoryless, scatter, *local = (w[own] for own in self.groups.values())
        fine, coarse, _ = self._sizes()
        crowd = table[:, :, fine : fine + coarse]
        folded = [
            self.density_share * (table[:, :, :fine] @ density),
            self.contrast_share * (crowd @ contrast),
            self.mixing_share * (crowd @ mixing),
        ]
        knots = self._memoryless_knots()
        margin = 2 * self.temperature_step_k
        places = np.arange(knots[0] - margin, knots[-1] + margin, 0.05)
        plateau = span * self.memoryless_share * (cubic_spline(knots, places) @ memoryless)
        shape, chosen, share, lowest = self._cells()
        cells = np.zeros(shape)
        cells.ravel()[chosen] = span * scatter * np.sqrt(share / self.domains)
        return Correction(
            basis=self,
            walls=walls,
            table=np.stack([*(span * part for part in folded), table[:, :, -1]], axis=2),
            plateau=np.stack([places, plateau]),
            cells=cells,
            lowest=lowest,
            local=tuple(span * self.local_share * own for own in local),
        )


@dataclass(frozen=True)
class Correction:
    """A correction with known weights, as a function of the temperature's path; made by `EnrichmentBasis.fold`."""

    basis: EnrichmentBasis
    walls: Floats
    table: Floats
    plateau: Floats
    cells: Floats
    lowest: float
    local: tuple[Floats, ...]

    def __call__(self, temperature: ArrayLike) -> Floats:
        """Return the correction (n,) along the temperature (n,) [degC] from a cold rest, in the channel's unit."""
        path = finite_array(temperature, "temperature")
        density, contrast, mixing, x = preisach_features(path, self.walls, self.table).T
        low, high = self.basis.centre_degc
        warmth = (path - 0.5 * (low + high)) / (0.5 * (high - low))
        plateau = np.interp(path, *self.plateau)
        scatter = cell_sum(path, low=self.lowest, step=self.basis.cell_k, weights=self.cells)
        total = density + warmth * contrast + x * mixing + plateau + scatter
        for kind, weights in zip(self.basis.local, self.local, strict=True):
            total += self.basis._elements(kind).total(path, weights)
        return total


@lru_cache(maxsize=4)
def _tables(basis: EnrichmentBasis) -> tuple[Floats, Floats]:
    """Walls and Everett functions: fine densities, coarse densities, the typical device's fraction."""
    low = basis.centre_degc[0] - basis.half_width_k
    high = basis.centre_degc[1] + basis.half_width_k
    walls = np.arange(low, high + 0.5 * basis.grid_k, basis.grid_k)
    centre, half_width = basis._knots()
    fine = everett_table(centre, half_width, walls)
    typical = [
        np.exp(-0.5 * ((knots - mean) / spread) ** 2)
        for knots, (mean, spread) in (
            (centre, basis.typical_centre),
            (half_width, basis.typical_half_width),
        )
    ]
    fraction = fine @ np.outer(*typical).ravel()
    fraction /= fraction.max()
    return walls, np.concatenate(
        [fine, everett_table(*basis._coarse_knots(), walls), fraction[..., None]], axis=2
    )
