"""Compiled regressors of tanh plays and their derivatives with respect to the envelopes.

The output of a play is the envelope value at the instant that last moved it (or its initial memory), so its
derivative is that of the envelope at that instant: it is carried along with the play, exactly and at no cost.
"""

from __future__ import annotations

import numpy as np

from vo2_models.hysteresis.kernels import exact, tanh
from vo2_models.numerics.kernel import kernel

RISING_SLOPE, RISING_OFFSET, FALLING_SLOPE, FALLING_OFFSET = range(4)


@exact
def regressors(z, slopes, radii, lower, outputs):
    """Outputs of the plays: z (n,), slopes (4, N) as numbered above -> outputs (n, N)."""
    n = radii.size
    memory = radii - 1.0 if lower else 1.0 - radii
    previous = -np.inf if lower else np.inf
    for k in range(z.size):
        v = z[k]
        if v > previous:
            for j in range(n):
                memory[j] = max(memory[j], tanh(slopes[0, j] * v + slopes[1, j]) - radii[j])
        elif v < previous:
            for j in range(n):
                memory[j] = min(memory[j], tanh(slopes[2, j] * v + slopes[3, j]) + radii[j])
        previous = v
        outputs[k, :] = memory


@exact
def derivatives(z, slopes, radii, lower, weights, columns, out):
    """Derivatives of the weighted sum of the plays: out (n, P) += d/dtheta.

    columns (4, N) says into which column of `out` the derivative with respect to parameter p of play j goes. Shared
    parameters name the same column for every play.
    """
    n = radii.size
    memory = radii - 1.0 if lower else 1.0 - radii
    by_slope = np.zeros(n)
    by_offset = np.zeros(n)
    rose = np.ones(n, dtype=np.bool_)
    previous = -np.inf if lower else np.inf
    for k in range(z.size):
        v = z[k]
        up = v > previous
        if v != previous:
            for j in range(n):
                row = 0 if up else 2
                g = tanh(slopes[row, j] * v + slopes[row + 1, j])
                level = g - radii[j] if up else g + radii[j]
                if (up and level > memory[j]) or (not up and level < memory[j]):
                    memory[j] = level
                    by_offset[j] = (1.0 - g) * (1.0 + g)
                    by_slope[j] = by_offset[j] * v
                    rose[j] = up
        previous = v
        for j in range(n):
            row = 0 if rose[j] else 2
            out[k, columns[row, j]] += weights[j] * by_slope[j]
            out[k, columns[row + 1, j]] += weights[j] * by_offset[j]


@kernel
def without_closed_loops(path, needed):
    """Indices of the samples that decide what any play does at the needed ones: path (n,), needed (n,) bool -> (m,).

    Between two needed samples, what lies on a monotonic way is left out, and so is every excursion b, c that ends within
    the way a to d around it: it closes a minor loop, which leaves a play as it was (Madelung's rules).
    """
    kept = np.empty(path.size, np.int64)
    count = begin = 0
    for k in range(path.size):
        kept[count] = k
        count += 1
        while count - begin >= 3:
            last, middle, first = path[k], path[kept[count - 2]], path[kept[count - 3]]
            if min(first, last) <= middle <= max(first, last):
                kept[count - 2] = k
                count -= 1
                continue
            if count - begin < 4:
                break
            before = path[kept[count - 4]]
            if min(first, middle) < min(before, last) or max(first, middle) > max(before, last):
                break
            kept[count - 3] = k
            count -= 2
        if needed[k]:
            begin = count - 1
    return kept[:count]
