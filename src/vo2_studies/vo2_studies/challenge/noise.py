"""Coloured measurement noise: a white part and a first-order autoregressive part of random correlation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

__all__ = ["ChannelNoise", "draw_noise", "sample_noise"]

Array = NDArray[np.floating]


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of one channel: standard deviation `sd` (channel's unit), coloured share of the variance, AR(1) rho."""

    sd: float
    coloured: float
    rho: float


def draw_noise(rng: np.random.Generator, level: float) -> ChannelNoise:
    """Draw a channel's noise around `level` (1 s.d.): 0.7 to 1.4 of it, rho 0 to 0.95, coloured share 0 to 0.9."""
    return ChannelNoise(
        sd=level * float(np.exp(rng.uniform(np.log(0.7), np.log(1.4)))),
        coloured=float(rng.uniform(0, 0.9)),
        rho=float(rng.uniform(0, 0.95)),
    )


def sample_noise(rng: np.random.Generator, noise: ChannelNoise, n: int) -> Array:
    """Return a stationary noise sequence (n,) in the channel's unit."""
    white = rng.standard_normal(n)
    drive = rng.standard_normal(n) * np.sqrt(1 - noise.rho**2)
    drive[0] = rng.standard_normal()  # stationary from the first sample
    coloured = lfilter([1.0], [1.0, -noise.rho], drive)
    return np.asarray(noise.sd * (np.sqrt(1 - noise.coloured) * white + np.sqrt(noise.coloured) * coloured))
