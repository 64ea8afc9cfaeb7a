"""Loops whose only memory is their state: what no Preisach operator has, and many devices do.

A Preisach operator closes its small loops and forgets by wiping out. Differential laws (Duhem's, Bouc and Wen's, Jiles and
Atherton's) and the limiting-loop model do neither: their small loops wander towards a steady one. To first order that is
a sum of elements with Duhem's rule, each of which transforms a share of what is left whatever the way there,

    heating  ds/dT = (1 - s) f_up / (1 - F_up),        cooling  ds/dT = s f_down / F_down,

F the logistic distributions of one scale about the element's temperatures of heating and of cooling. Along a branch

    (1 - s) / (1 - s_0) = G_up(T) / G_up(T_0),   G_up = 1 - F_up;        s / s_0 = F_down(T) / F_down(T_0),

so that a sample costs one look-up in a table of G_up or F_down, whatever came before. Visintin, Differential Models of
Hysteresis, 1994, section V; Likhachev and Koval, Scripta Metall. Mater. 27, 223, 1992, for shape memory alloys.

A second kind of element remembers its last turn and returns to its limiting branch from there, as de Almeida et al. found of
VO2 films: see `hysteresis.limiting_loop`, whose equations it has with one slope, a = 1 / (2 scale).

A third kind lags behind by a half width r that builds up over a way, as the force of Dahl's friction and of Bouc and Wen's law,

    s = 1 / (1 + exp(-(T - r x - c) / scale)),        dx/d|T| = (sgn dT - x) / (rho r).

Dahl, AIAA J. 14, 1675, 1976; Visintin, section V.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.limiting_loop import GAMMA
from vo2_models.numerics.kernel import kernel

__all__ = ["FadingLags", "LimitingLoops", "LocalMemory"]

Floats = NDArray[np.float64]
STEP = 0.03
"""Spacing of the tables, in the shortest scale: 1e-4 of a fraction."""
FAR = 30.0
"""Reach of the tables beyond all elements, in the longest scale: nothing moves there."""
FADED, FINE = 3.5, 2000
"""Distance at which the proximity function has faded, and entries of its table per unit."""
SATURATED = 18.0
"""Argument of the tanh that counts as saturation."""


@kernel(nogil=True)
def _branches(temperature, low, step, heating, cooling, out):
    """Fractions (n, m) along the path, from cold saturation."""
    last_place, m = heating.shape[0] - 1, heating.shape[1]
    ahead = np.ones(m)  # (1 - s_0) / G_up(T_0) while heating, s_0 / F_down(T_0) while cooling
    rising, before, last = True, 0.0, 0.0
    for k in range(temperature.size):
        x = min(max((temperature[k] - low) / step, 0.0), last_place - 1e-6)
        if k > 0 and x == last:
            out[k] = out[k - 1]
            continue
        now = k == 0 or x > last
        if now != rising:
            rising = now
            i = int(last)
            before = last - i
            table = heating if rising else cooling
            for j in range(m):
                there = (1.0 - before) * table[i, j] + before * table[i + 1, j]
                ahead[j] = (1.0 - out[k - 1, j] if rising else out[k - 1, j]) / there
        i = int(x)
        f = x - i
        if rising:
            for j in range(m):
                out[k, j] = 1.0 - ahead[j] * ((1.0 - f) * heating[i, j] + f * heating[i + 1, j])
        else:
            for j in range(m):
                out[k, j] = ahead[j] * ((1.0 - f) * cooling[i, j] + f * cooling[i + 1, j])
        last = x


@kernel(nogil=True)
def _sum(temperature, low, step, heating, cooling, weights, out):
    """The same, summed with weights (m,): the fractions themselves are needed at turns only."""
    last_place, m = heating.shape[0] - 1, heating.shape[1]
    ahead = weights.copy()
    whole = 0.0
    for j in range(m):
        whole += weights[j]
    rising, last = True, 0.0
    for k in range(temperature.size):
        x = min(max((temperature[k] - low) / step, 0.0), last_place - 1e-6)
        if k > 0 and x == last:
            out[k] = out[k - 1]
            continue
        now = k == 0 or x > last
        if now != rising:
            i = int(last)
            f = last - i
            for j in range(m):
                up = (1.0 - f) * heating[i, j] + f * heating[i + 1, j]
                down = (1.0 - f) * cooling[i, j] + f * cooling[i + 1, j]
                # weight times fraction, by the branch that ends here
                moved = weights[j] - ahead[j] * up if rising else ahead[j] * down
                ahead[j] = moved / down if rising else (weights[j] - moved) / up
            rising = now
        i = int(x)
        f = x - i
        table = heating if rising else cooling
        total = 0.0
        for j in range(m):
            total += ahead[j] * ((1.0 - f) * table[i, j] + f * table[i + 1, j])
        out[k] = whole - total if rising else total
        last = x


@kernel(nogil=True)
def _tanh(x, table):
    """Return tanh(x) from a table of (1 + tanh) / 2 over -SATURATED to SATURATED."""
    place = (min(max(x, -SATURATED), SATURATED) + SATURATED) * (table.size - 2) / (2.0 * SATURATED)
    i = int(place)
    return 2.0 * (table[i] + (place - i) * (table[i + 1] - table[i])) - 1.0


@kernel(nogil=True)
def _limiting(temperature, rising, falling, slope, near, saturation, weights, out):
    """Sum (n,) of the limiting loops' fractions along the path, weights (m,); or, with none, every fraction (n, m)."""
    m = rising.size
    argument = np.full(m, -np.inf)
    level = np.full(m, -np.inf)
    ahead = np.zeros(m)  # distance of the turn from the branch, 0 for none
    turn, last, up = 0.0, -np.inf, True
    for k in range(temperature.size):
        u = temperature[k]
        if u == last:
            out[k] = out[k - 1]
            continue
        if (u > last) != up:
            up = not up
            turn = last
            for j in range(m):
                level[j] = argument[j]
                centre = rising[j] if up else falling[j]
                ahead[j] = 0.0
                if abs(level[j]) < SATURATED:
                    distance = centre + level[j] / slope[j] - turn
                    if distance != 0.0 and (distance > 0.0) == up:
                        ahead[j] = distance
        last = u
        total = 0.0
        for j in range(m):
            shift = 0.0
            if ahead[j] != 0.0:
                z = (u - turn) / ahead[j]
                if z < FADED:
                    place = z * FINE
                    i = int(place)
                    shift = ahead[j] * (near[i] + (place - i) * (near[i + 1] - near[i]))
            argument[j] = slope[j] * (u + shift - (rising[j] if up else falling[j]))
            fraction = 0.5 * (1.0 + _tanh(argument[j], saturation))
            if weights.size:
                total += weights[j] * fraction
            else:
                out[k, j] = fraction
        if weights.size:
            out[k, 0] = total


@kernel(nogil=True)
def _fading(temperature, lag, way, centre, slope, saturation, weights, out):
    """Sum (n,) of the elements' fractions along the path, weights (l, m) for l lags; or, with none, every fraction (n, l m)."""
    m = centre.size
    behind = np.ones(lag.size)  # as after a long rise
    last = temperature[0]
    for k in range(temperature.size):
        u = temperature[k]
        if k > 0 and u == last:
            out[k] = out[k - 1]
            continue
        total = 0.0
        for i in range(lag.size):
            towards = 1.0 if u > last else -1.0
            behind[i] = towards + (behind[i] - towards) * np.exp(-abs(u - last) / way[i])
            level = u - lag[i] * behind[i]
            for j in range(m):
                fraction = 0.5 * (1.0 + _tanh(slope[j] * (level - centre[j]), saturation))
                if weights.size:
                    total += weights[i, j] * fraction
                else:
                    out[k, i * m + j] = fraction
        if weights.size:
            out[k, 0] = total
        last = u


@dataclass(frozen=True)
class _Grid:
    """Elements on a grid.

    Attributes
    ----------
    centre, half_width : means of the temperatures of heating and cooling, and half their distance [degC, K]
    scale : of the logistic distributions [K]
    """

    centre: tuple[float, ...]
    half_width: tuple[float, ...]
    scale: tuple[float, ...]

    @property
    def size(self) -> int:
        """Number m of elements."""
        return len(self.centre) * len(self.half_width) * len(self.scale)

    def features(self, path: Floats) -> Floats:
        """Return the fractions (n, m) along a temperature (n,) [degC] from cold saturation."""
        raise NotImplementedError

    def total(self, path: Floats, weights: Floats) -> Floats:
        """Return `features(path) @ weights` (n,) for weights (m,)."""
        raise NotImplementedError

    def _each(self) -> tuple[Floats, Floats, Floats]:
        """Centre, half width and scale of every element, (m,) each."""
        centre, half_width, scale = np.meshgrid(self.centre, self.half_width, self.scale, indexing="ij")
        return centre.ravel(), half_width.ravel(), scale.ravel()


class LocalMemory(_Grid):
    """Elements of Duhem's kind."""

    def features(self, path: Floats) -> Floats:
        out = np.zeros((path.size, self.size))
        _branches(path, *_tables(self), out)
        return out

    def total(self, path: Floats, weights: Floats) -> Floats:
        out = np.zeros(path.size)
        _sum(path, *_tables(self), weights, out)
        return out


class LimitingLoops(_Grid):
    """Elements of the limiting-loop kind."""

    def features(self, path: Floats) -> Floats:
        return self._run(path, np.empty(0), self.size)

    def total(self, path: Floats, weights: Floats) -> Floats:
        return np.ascontiguousarray(self._run(path, weights, 1)[:, 0])

    def _run(self, path: Floats, weights: Floats, columns: int) -> Floats:
        c, r, s = self._each()
        out = np.empty((path.size, columns))
        _limiting(path, c + r, c - r, 0.5 / s, *_curves(), weights, out)
        return out


@dataclass(frozen=True)
class FadingLags(_Grid):
    """Elements that lag behind by a width that builds up.

    Attributes
    ----------
    reach : rho, way over which the lag builds up, in half widths [1]
    """

    reach: tuple[float, ...] = (1.2, 2.5)

    @property
    def size(self) -> int:
        """Number m of elements."""
        return len(self.reach) * super().size

    def features(self, path: Floats) -> Floats:
        return self._run(path, np.empty(0), self.size)

    def total(self, path: Floats, weights: Floats) -> Floats:
        return np.ascontiguousarray(self._run(path, weights, 1)[:, 0])

    def _run(self, path: Floats, weights: Floats, columns: int) -> Floats:
        lag, way = (a.ravel() for a in np.meshgrid(self.half_width, self.reach, indexing="ij"))
        centre, scale = (a.ravel() for a in np.meshgrid(self.centre, self.scale, indexing="ij"))
        out = np.empty((path.size, columns))
        each = weights.reshape(-1, centre.size)
        _fading(path, lag, lag * way, centre, 0.5 / scale, _curves()[1], each, out)
        return out


@cache
def _curves() -> tuple[Floats, Floats]:
    """Table of the proximity function over 0 to FADED, and of (1 + tanh) / 2 over -SATURATED to SATURATED."""
    from scipy.special import expit  # loads slowly, and a node starts without it

    z = np.arange(int(FADED * FINE) + 2) / FINE
    near = 0.5 * (1.0 - np.sin(GAMMA * z)) * (1.0 + np.tanh(np.pi * (np.pi - 2.0 * z)))
    x = np.linspace(-SATURATED, SATURATED, int(2 * SATURATED * FINE / 20))
    return near, np.append(expit(2.0 * x), 1.0)


@lru_cache(maxsize=8)
def _tables(elements: LocalMemory) -> tuple[float, float, Floats, Floats]:
    """Lowest temperature, step, and G_up and F_down on the grid, each (p, m)."""
    from scipy.special import expit

    c, r, s = elements._each()
    reach = FAR * max(elements.scale)
    low, high = float(np.min(c - r)) - reach, float(np.max(c + r)) + reach
    step = STEP * min(elements.scale)
    places = np.arange(low, high, step)[:, None]
    return low, step, expit((c + r - places) / s), expit((places - c + r) / s)
