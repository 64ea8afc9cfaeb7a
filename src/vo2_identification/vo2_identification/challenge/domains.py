"""The concealed device's hysteresis: grains in clusters, each grain a relay with its own two thresholds.

A film is a set of grain clusters (grain size, strain and stoichiometry vary from place to place). Within
cluster j the grains' mid temperatures follow one quantile function z_j (normal, Student or skew), scaled by
s_j and shifted by m_j; the loop width w_j(q) grows or falls along the cluster, because small grains are both
later to nucleate and more supercooled (correlated coercivity; Lopez et al., Phys. Rev. B 65, 224113, 2002):

    heating threshold  alpha = m_j + s_j z_j(q) + w_j(q) / 2
    cooling threshold  beta  = m_j + s_j z_j(q) - w_j(q) / 2,    w_j(q) = w_j (1 + c_j (2 q - 1))

With `misfit` 0 the clusters differ only in their width: a play-type family. `misfit` 0.1 scatters the widths
(play radii), the scales (envelope slopes) and the mid temperatures by 10 per cent, cluster by cluster, which no
model with envelopes common to all plays can follow. Any sum of relays has the wiping-out property.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

__all__ = ["Domains", "draw_domains", "major_loop"]

CLUSTERS = 24
GRAINS = 500
"""Grains per cluster: 12 000 steps of 8e-5 each stay far below the sensors' noise."""

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Domains:
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


def _quantile(shape: str, q: Array, skew: float) -> Array:
    """Return the standardised quantile function (mean 0, s.d. 1) of one envelope shape at q (n,)."""
    if shape == "normal":
        return stats.norm.ppf(q)
    if shape == "student":
        return stats.t.ppf(q, 6) / np.sqrt(6 / 4)
    if shape == "skew":
        law = stats.skewnorm(skew)
        return (law.ppf(q) - law.mean()) / law.std()
    raise ValueError(f"shape: found {shape!r}, need normal, student or skew")


def draw_domains(
    rng: np.random.Generator,
    *,
    heating_mean: float,
    heating_sd: float,
    width_mean: float,
    width_sd: float,
    offset_mean: float,
    offset_sd: float,
    misfit: float = 0.1,
) -> Domains:
    """Draw one film.

    Parameters
    ----------
    rng : source of randomness
    heating_mean, heating_sd : heating threshold over the material [degC, K]
    width_mean, width_sd : loop width over the material [K]
    offset_mean, offset_sd : structural minus metallic threshold over the material [K]
    misfit : relative scatter of widths, scales and mids from cluster to cluster [1], 0 to 0.3

    Raises
    ------
    ValueError : misfit outside 0 to 0.3
    """
    if not 0 <= misfit <= 0.3:
        raise ValueError(f"misfit: found {misfit}, need 0 to 0.3")
    share = rng.gamma(4.0, size=CLUSTERS)
    share /= share.sum()
    width = np.sort(np.maximum(width_mean + width_sd * stats.norm.ppf(_strata(rng, CLUSTERS)), 0.6))
    shape = rng.choice(["normal", "student", "skew"])
    skew = rng.uniform(1.0, 3.0) * rng.choice([-1, 1])
    # the mids carry the heating threshold's spread minus what the widths bring in already
    mid_sd = np.sqrt(max(heating_sd**2 - (width_sd / 2) ** 2, 0.25 * heating_sd**2))
    scale = mid_sd * (1 + misfit * rng.standard_normal(CLUSTERS))
    width = width * (1 + misfit * rng.standard_normal(CLUSTERS))
    mid = heating_mean - width_mean / 2 + misfit * mid_sd * rng.standard_normal(CLUSTERS)
    along = misfit * rng.standard_normal(CLUSTERS)
    offset_cluster = rng.standard_normal(CLUSTERS) * np.sqrt(0.3) * offset_sd

    q = (np.arange(GRAINS) + 0.5) / GRAINS
    z = _quantile(str(shape), q, float(skew))
    centre = mid[:, None] + scale[:, None] * z
    grain_width = np.maximum(width[:, None] * (1 + along[:, None] * (2 * q - 1)), 0.3)
    up, down = centre + grain_width / 2, centre - grain_width / 2
    within = (
        np.sqrt(0.7) * offset_sd * stats.norm.ppf(np.stack([rng.permutation(q) for _ in range(CLUSTERS)]))
    )
    offset = offset_mean + offset_cluster[:, None] + within
    weight = np.repeat(share / GRAINS, GRAINS)
    return Domains(up.ravel(), down.ravel(), (up + offset).ravel(), (down + offset).ravel(), weight)


def _strata(rng: np.random.Generator, n: int) -> Array:
    """Return n probabilities (n,), one in each of n equal strata."""
    return np.asarray((np.arange(n) + rng.uniform(0.05, 0.95, n)) / n)


def major_loop(domains: Domains, temperature_degC: Array) -> tuple[Array, Array, Array, Array]:
    """Return the major loop's fractions at `temperature_degC` (n,): metal up, metal down, structure up and down."""

    def share(thresholds: Array) -> Array:
        order = np.argsort(thresholds)
        total = np.concatenate([[0.0], np.cumsum(domains.weight[order])])
        return np.asarray(total[np.searchsorted(thresholds[order], temperature_degC, side="right")])

    return (
        share(domains.up_metal),
        share(domains.down_metal),
        share(domains.up_structure),
        share(domains.down_structure),
    )
