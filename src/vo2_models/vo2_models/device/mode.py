"""One lightly damped mode of the structure, advanced exactly from sample to sample."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["mode_step"]


def mode_step(
    frequency: float, damping: float, period: float, *, time_constant: float = math.inf
) -> NDArray[np.float64]:
    """Exact step of z'' + 2 zeta w z' + w^2 z = w^2 u over a sample period.

    Between samples u goes from the last to the new one as what relaxes with a time constant does: A + B exp(-t / tau).
    Heat under a held current moves like that. Without time constant it goes straight.

    Parameters
    ----------
    frequency : undamped natural frequency w / (2 pi) [Hz]
    damping : ratio zeta
    period : [s]
    time_constant : tau [s]

    Returns
    -------
    (2, 4) : rows give the next z and z'/w from (z, z'/w, last u, new u).
    """
    from scipy.linalg import expm  # loads slowly, and a node starts without it

    angle = 2.0 * math.pi * frequency * period
    big = np.zeros((4, 4))
    big[0, 1] = angle
    big[1, :3] = [-angle, -2.0 * damping * angle, angle]
    heat = period / time_constant
    if heat > 1e-3:
        big[1, 3] = angle
        big[3, 3] = -heat
        z, rate, held, fading = expm(big)[:2].T
        gone = -math.expm1(-heat)
        return np.ascontiguousarray(
            np.column_stack([z, rate, (fading - (1.0 - gone) * held) / gone, (held - fading) / gone])
        )
    big[2, 3] = 1.0  # u grows by (new - last) over the unit interval
    step = expm(big)[:2]
    return np.ascontiguousarray(
        np.column_stack([step[:, 0], step[:, 1], step[:, 2] - step[:, 3], step[:, 3]])
    )
