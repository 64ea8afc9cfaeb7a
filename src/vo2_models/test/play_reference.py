"""The play family written straight from (B.5)-(B.8) and (6.1) in plain Python: slow, and plain to see."""

from __future__ import annotations

import math


def play(v, previous, w, radius, rising, falling):
    """(B.6) with the envelope letters as the order condition needs them (errata)."""
    if v > previous:
        return max(rising(v) - radius, w)
    if v < previous:
        return min(falling(v) + radius, w)
    return w


def egpi(inputs, radii, weights, pairs, memoryless, bias, previous, memory):
    """Output sequence and final memory; `pairs` holds (gamma_R, gamma_L) of each play."""
    outputs = []
    memory = list(memory)
    for v in inputs:
        memory = [
            play(v, previous, w, r, rising, falling)
            for w, r, (rising, falling) in zip(memory, radii, pairs, strict=True)
        ]
        previous = v
        total = math.fsum(p * w for p, w in zip(weights, memory, strict=True))
        outputs.append(bias + memoryless(v) + total)
    return outputs, memory


def tanh_pair(a_r, b_r, a_l, b_l):
    return (lambda v: math.tanh(a_r * v + b_r)), (lambda v: math.tanh(a_l * v + b_l))
