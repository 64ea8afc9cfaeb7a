"""Independent domains: thousands of relays (grains), each with its own two thresholds.

Two kinds, both sums of relays, hence with the wiping-out property:

`plays`: a generalised-play ensemble whose envelopes are not tanh but normal, Student or skew-normal distribution
functions F (scaled to -1..1), unequal for heating and cooling. A play of radius r between envelopes 2 F - 1 is the
set of relays with thresholds, over y in (-(1 - r), 1 - r),

    alpha(y) = b_R + s_R z((1 + y + r) / 2),    beta(y) = b_L + s_L z((1 + y - r) / 2),    z = F^-1.

`misfit` 0.1 scatters every play's radius and both of its envelope slopes by 10 per cent, play by play, which no
model with envelopes common to all plays can follow. The structural transition's offset scatters from grain to
grain besides, so that the deflection is no sum of plays at all. The best fit of a sum of 19 plays with common tanh
envelopes leaves 0.05 to 0.6 per cent of range.

`clusters`: grain clusters (grain size, strain and stoichiometry vary from place to place) with widths that grow or
fall along the cluster, because small grains nucleate later and supercool more (correlated coercivity; Lopez et
al., Phys. Rev. B 65, 224113, 2002). Its density is about normal in width and position: further away from any
play-type model than 10 per cent (0.6 to 0.7 per cent of range remain), a harder test than the default.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import owens_t

from vo2_studies.challenge.families.law import Film, Statistics
from vo2_studies.challenge.families.relays import relays

__all__ = ["Grains", "draw", "draw_grains"]

PLAYS = 24
"""Plays or clusters of one film."""
GRAINS = 500
"""Grains of each: 12 000 steps of 8e-5 each stay far below the sensors' noise."""

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Grains:
    """Thresholds and weights of all grains, each (n,): two transitions, metallic and structural.

    Attributes
    ----------
    up_metal, down_metal : temperature where a grain turns metallic on heating, back on cooling [degC]
    up_structure, down_structure : the same for the lattice [degC]
    weight : share of the material [1], sum 1
    """

    up_metal: Array
    down_metal: Array
    up_structure: Array
    down_structure: Array
    weight: Array


@dataclass(frozen=True)
class _Shape:
    """Standardised quantile function (mean 0, s.d. 1) of an envelope."""

    name: str
    skew: float

    def quantile(self, q: Array) -> Array:
        if self.name == "normal":
            return np.asarray(stats.norm.ppf(q))
        if self.name == "student":
            return np.asarray(stats.t.ppf(q, 7) / np.sqrt(7 / 5))
        # Azzalini's law, inverted from a table: F(z) = Phi(z) - 2 T(z, a), Owen's T
        z = np.linspace(-6, 6, 4001)
        mean = self.skew / np.sqrt(1 + self.skew**2) * np.sqrt(2 / np.pi)
        table = stats.norm.cdf(z) - 2 * owens_t(z, self.skew)
        return np.asarray((np.interp(q, table, z) - mean) / np.sqrt(1 - mean**2))


def draw(rng: np.random.Generator, film: Statistics, misfit: float, *, kind: str) -> Film:
    """Draw a film of independent grains; `kind` is "plays" or "clusters"."""
    grains = draw_grains(rng, film, misfit, kind)
    return Film(
        relays(grains.up_metal, grains.down_metal, grains.weight),
        relays(grains.up_structure, grains.down_structure, grains.weight),
    )


def draw_grains(rng: np.random.Generator, film: Statistics, misfit: float, kind: str) -> Grains:
    """Draw the grains of one film.

    `misfit` scatters play radii and envelope slopes (or cluster widths and scales) relatively [1].
    """
    shape = _Shape(
        str(rng.choice(["normal", "student", "skew"])), float(rng.uniform(0.7, 2.0) * rng.choice([-1, 1]))
    )
    parts = _plays if kind == "plays" else _clusters
    up, down, weight = parts(
        rng, shape, film.heating_mean, film.heating_sd, film.width_mean, film.width_sd, misfit
    )
    part = np.sqrt(0.3) * film.offset_sd * rng.standard_normal((PLAYS, 1))
    place = np.stack([rng.permutation(GRAINS) for _ in range(PLAYS)])
    within = np.sqrt(0.7) * film.offset_sd * stats.norm.ppf((place + 0.5) / GRAINS)
    offset = film.offset_mean + part + within
    return Grains(up.ravel(), down.ravel(), (up + offset).ravel(), (down + offset).ravel(), weight.ravel())


def _moments(values: Array, weight: Array) -> tuple[float, float]:
    mean = float(np.sum(weight * values))
    return mean, float(np.sqrt(np.sum(weight * (values - mean) ** 2)))


def _plays(
    rng: np.random.Generator,
    shape: _Shape,
    heating_mean: float,
    heating_sd: float,
    width_mean: float,
    width_sd: float,
    misfit: float,
) -> tuple[Array, Array, Array]:
    """Return up, down, weight (plays, grains) of the play family with the given moments."""
    share = rng.gamma(4.0, size=PLAYS)
    strata = (np.arange(PLAYS) + rng.uniform(0.05, 0.95, PLAYS)) / PLAYS
    radius_error, up_error, down_error = 1 + misfit * np.clip(rng.standard_normal((3, PLAYS)), -2.5, 2.5)
    asymmetry = float(rng.uniform(0.88, 1.14))  # cooling envelope against heating envelope
    along = (np.arange(GRAINS) + 0.5) / GRAINS * 2 - 1
    largest, scale = 0.5, heating_sd
    for _ in range(12):  # moments of the material from envelopes and radii: fixed-point iteration
        radius = np.clip(largest * strata * radius_error, 0.0, 0.9)[:, None]
        y = along * (1 - radius)
        up = scale * up_error[:, None] * shape.quantile((1 + y + radius) / 2)
        down = scale * asymmetry * down_error[:, None] * shape.quantile((1 + y - radius) / 2)
        weight = share[:, None] * (1 - radius) * np.ones(GRAINS)
        weight /= weight.sum()
        _width, spread = _moments(up - down, weight)
        largest = float(np.clip(largest * (width_sd / spread) ** 0.7, 0.05, 0.85))
        scale *= heating_sd / _moments(up, weight)[1]
    up += heating_mean - _moments(up, weight)[0]
    down += _moments(up - down, weight)[0] - width_mean
    # a relay's thresholds are ordered: crossing envelopes are no physical play
    middle, width_of = (up + down) / 2, np.maximum(up - down, 0.3)
    return middle + width_of / 2, middle - width_of / 2, weight


def _clusters(
    rng: np.random.Generator,
    shape: _Shape,
    heating_mean: float,
    heating_sd: float,
    width_mean: float,
    width_sd: float,
    misfit: float,
) -> tuple[Array, Array, Array]:
    """Return up, down, weight (clusters, grains) of the cluster family with the given moments."""
    share = rng.gamma(4.0, size=PLAYS)
    share /= share.sum()
    strata = (np.arange(PLAYS) + rng.uniform(0.05, 0.95, PLAYS)) / PLAYS
    width = np.sort(np.maximum(width_mean + width_sd * stats.norm.ppf(strata), 0.6))
    # the mids carry the heating threshold's spread minus what the widths bring in already
    mid_sd = np.sqrt(max(heating_sd**2 - (width_sd / 2) ** 2, 0.25 * heating_sd**2))
    scale = mid_sd * (1 + misfit * rng.standard_normal(PLAYS))
    width = width * (1 + misfit * rng.standard_normal(PLAYS))
    mid = heating_mean - width_mean / 2 + misfit * mid_sd * rng.standard_normal(PLAYS)
    growth = misfit * rng.standard_normal(PLAYS)
    q = (np.arange(GRAINS) + 0.5) / GRAINS
    centre = mid[:, None] + scale[:, None] * shape.quantile(q)
    grain_width = np.maximum(width[:, None] * (1 + growth[:, None] * (2 * q - 1)), 0.3)
    weight = np.repeat(share / GRAINS, GRAINS).reshape(PLAYS, GRAINS)
    return centre + grain_width / 2, centre - grain_width / 2, weight
