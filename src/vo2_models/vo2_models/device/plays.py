"""The play bank inside the compiled core: tanh envelopes, one pair per play, a move made or only tried.

It is `hysteresis.kernels.egpi_step` for this one kind of model, on the same packed vector and the same memory.
It exists because the core calls it several times per sample: it takes no slices (each costs two atomic reference
counts in a compiled loop), tries a move without copying the memory, and takes tanh from exp, which is about
twice as fast as the library's and equally accurate in absolute terms.
"""

from __future__ import annotations

import math

from numba import njit

from vo2_models.hysteresis.layout import HEADER

__all__ = ["bank_output"]


@njit(cache=True, error_model="numpy")
def bank_output(v, packed, memory, make):
    """Weighted sum of the plays at the input v [degC]; the memory (1 + N,) moves there where `make` is true."""
    n = int(packed[0])
    previous = memory[0]
    total = 0.0
    if v == previous:
        for j in range(n):
            total += packed[HEADER + j] * memory[1 + j]
        return total
    rising = v > previous
    start = HEADER + 2 * n if rising else HEADER + 4 * n
    for j in range(n):
        argument = packed[start + j] * v + packed[start + n + j]
        e = math.exp(-2.0 * abs(argument))
        gamma = math.copysign((1.0 - e) / (1.0 + e), argument)
        radius = packed[HEADER + n + j]
        level = memory[1 + j]
        level = max(gamma - radius, level) if rising else min(gamma + radius, level)
        if make:
            memory[1 + j] = level
        total += packed[HEADER + j] * level
    if make:
        memory[0] = v
    return total
