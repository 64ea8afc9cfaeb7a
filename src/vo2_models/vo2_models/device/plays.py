"""The play bank inside the compiled core: tanh envelopes, one pair per play, a move made or only tried.

It is `hysteresis.kernels.egpi_step` for this one kind of model, on the same packed vector and the same memory.
It exists because the core calls it several times per sample: it takes no slices (each costs two atomic reference
counts in a compiled loop), tries a move without copying the memory, and its tanh has no branch and no call, so
that the compiler takes several plays at a time.
"""

from __future__ import annotations

import math

from vo2_models.hysteresis.layout import HEADER
from vo2_models.numerics.kernel import kernel

__all__ = ["bank_middle", "bank_output", "tanh"]

_FARTHEST = 40.0
"""Where tanh is 1 to the last bit: exp(-40) < 2^-54."""


@kernel(inline="always")
def tanh(a):
    """tanh a from p = exp(-2 |a|) - 1, which is within 1e-15 of the value, relatively too.

    p of a 1024th of the exponent is a short series, and p(2y) = p(y) (2 + p(y)) doubles it ten times.
    """
    y = max(-2.0 * abs(a), -_FARTHEST) * (1.0 / 1024.0)
    p = y * (1.0 + y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + y * (1 / 720 + y * (1 / 5040)))))))
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    p *= 2.0 + p
    return math.copysign(-p / (2.0 + p), a)


# the sum may be taken in another order: that is what lets several plays be taken at a time
@kernel(fastmath={"reassoc", "contract", "nsz"})
def bank_output(v, packed, memory, make):
    """Weighted sum of the plays at the input v [degC]; the memory (1 + N,) moves there where `make` is true."""
    n = int(packed[0])
    previous = memory[0]
    total = 0.0
    if v == previous:
        for j in range(n):
            total += packed[HEADER + j] * memory[1 + j]
        return total
    if v > previous:
        for j in range(n):
            place = HEADER + j
            gamma = tanh(packed[place + 2 * n] * v + packed[place + 3 * n])
            level = max(gamma - packed[place + n], memory[1 + j])
            if make:
                memory[1 + j] = level
            total += packed[place] * level
    else:
        for j in range(n):
            place = HEADER + j
            gamma = tanh(packed[place + 4 * n] * v + packed[place + 5 * n])
            level = min(gamma + packed[place + n], memory[1 + j])
            if make:
                memory[1 + j] = level
            total += packed[place] * level
    if make:
        memory[0] = v
    return total


@kernel(fastmath={"reassoc", "contract", "nsz"})
def bank_middle(v, packed):
    """Weighted sum of the plays half way between the two major branches at the input v [degC]."""
    n = int(packed[0])
    total = 0.0
    for j in range(n):
        place = HEADER + j
        radius = packed[place + n]
        heating = max(tanh(packed[place + 2 * n] * v + packed[place + 3 * n]) - radius, radius - 1.0)
        cooling = min(tanh(packed[place + 4 * n] * v + packed[place + 5 * n]) + radius, 1.0 - radius)
        total += packed[place] * 0.5 * (heating + cooling)
    return total
