"""Compiled kernels of the play family on plain arrays; other compiled loops may call them.

A model is one float64 vector `packed`, its memory one float64 vector `state`:

    state  = [v_prev, w_1 ... w_N]                      present input, then the play outputs
    packed = [N, kind, shared, stride, bias, terms,     header
              weights (N), radii (N),
              rising envelopes (M * stride), falling envelopes (M * stride),   M = 1 if shared else N
              memoryless terms: kind, count, parameters (count), ...]

Envelope kinds: LINEAR a v + b and TANH tanh(a v + b) store M slopes and then M offsets (stride 2); TABLE stores
for each of the M tables its knots' inputs and then their outputs (stride = twice the number of knots), and goes on
with the end slopes outside. Memoryless kinds: POLYNOMIAL [c0, c1, ...], SINE [amplitude, frequency, phase],
SATURATION amplitude * tanh(slope * v + offset) [amplitude, slope, offset].

The play is the rising/falling form of (B.5)-(B.6) with the envelope letters as the order condition needs
them: rising w = max(gamma_R(v) - r, w), falling w = min(gamma_L(v) + r, w). Only one envelope is evaluated
per sample, which halves the cost of the transcendental functions.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from vo2_models.hysteresis.layout import HEADER, LINEAR, POLYNOMIAL, SINE, TANH

# Reassociation lets the weighted sum over the plays use vector registers; it changes results by rounding only.
summing = njit(cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
exact = njit(cache=True, error_model="numpy")


@exact
def table_value(inputs, outputs, v):
    """Piecewise-linear function through strictly increasing knots, with its end slopes outside."""
    k = np.searchsorted(inputs, v) - 1
    k = min(max(k, 0), inputs.size - 2)
    slope = (outputs[k + 1] - outputs[k]) / (inputs[k + 1] - inputs[k])
    return outputs[k] + slope * (v - inputs[k])


@exact
def envelope_value(kind, block, members, stride, j, v):
    """Envelope j of a block of `members` envelopes at the input v."""
    if kind == LINEAR:
        return block[j] * v + block[members + j]
    if kind == TANH:
        return math.tanh(block[j] * v + block[members + j])
    knots = stride // 2
    table = block[j * stride : (j + 1) * stride]
    return table_value(table[:knots], table[knots:], v)


@exact
def envelope_slope(kind, block, members, stride, j, v):
    """Derivative of envelope j at the input v (of the segment to the right at a knot)."""
    if kind == LINEAR:
        return block[j]
    if kind == TANH:
        g = math.tanh(block[j] * v + block[members + j])
        return block[j] * (1.0 - g) * (1.0 + g)
    knots = stride // 2
    inputs = block[j * stride : j * stride + knots]
    outputs = block[j * stride + knots : (j + 1) * stride]
    k = min(max(np.searchsorted(inputs, v, side="right") - 1, 0), knots - 2)
    return (outputs[k + 1] - outputs[k]) / (inputs[k + 1] - inputs[k])


@exact
def envelope_inverse(kind, block, members, stride, j, g):
    """Input at which envelope j takes the value g; -inf or inf where it never does."""
    if kind == LINEAR:
        return (g - block[members + j]) / block[j]
    if kind == TANH:
        if g >= 1.0:
            return math.inf
        if g <= -1.0:
            return -math.inf
        return (math.atanh(g) - block[members + j]) / block[j]
    knots = stride // 2
    table = block[j * stride : (j + 1) * stride]
    return table_value(table[knots:], table[:knots], g)


@exact
def memoryless_value(terms, count, v):
    """Sum of `count` packed memoryless terms at the input v."""
    total = 0.0
    at = 0
    for _ in range(count):
        kind = int(terms[at])
        size = int(terms[at + 1])
        if kind == POLYNOMIAL:
            value = 0.0
            for k in range(size - 1, -1, -1):
                value = value * v + terms[at + 2 + k]
        elif kind == SINE:
            value = terms[at + 2] * math.sin(terms[at + 3] * v + terms[at + 4])
        else:
            value = terms[at + 2] * math.tanh(terms[at + 3] * v + terms[at + 4])
        total += value
        at += 2 + size
    return total


@exact
def memoryless_slope(terms, count, v):
    """Derivative of the sum of `count` packed memoryless terms at the input v."""
    total = 0.0
    at = 0
    for _ in range(count):
        kind = int(terms[at])
        size = int(terms[at + 1])
        if kind == POLYNOMIAL:
            value = 0.0
            for k in range(size - 1, 0, -1):
                value = value * v + k * terms[at + 2 + k]
        elif kind == SINE:
            value = terms[at + 2] * terms[at + 3] * math.cos(terms[at + 3] * v + terms[at + 4])
        else:
            g = math.tanh(terms[at + 3] * v + terms[at + 4])
            value = terms[at + 2] * terms[at + 3] * (1.0 - g) * (1.0 + g)
        total += value
        at += 2 + size
    return total


@summing
def _rise(g, radii, memory):
    for j in range(memory.size):
        level = g - radii[j]
        memory[j] = level if level > memory[j] else memory[j]


@summing
def _fall(g, radii, memory):
    for j in range(memory.size):
        level = g + radii[j]
        memory[j] = level if level < memory[j] else memory[j]


@summing
def _move(v, previous, n, kind, shared, stride, packed, radii, memory):
    """Bring the play memory (N,) from the input `previous` to v."""
    if v == previous:
        return
    members = 1 if shared else n
    start = HEADER + 2 * n
    if v > previous:
        block = packed[start : start + members * stride]
        if shared:
            _rise(envelope_value(kind, block, 1, stride, 0, v), radii, memory)
        else:
            for j in range(n):
                level = envelope_value(kind, block, n, stride, j, v) - radii[j]
                memory[j] = max(level, memory[j])
    else:
        block = packed[start + members * stride : start + 2 * members * stride]
        if shared:
            _fall(envelope_value(kind, block, 1, stride, 0, v), radii, memory)
        else:
            for j in range(n):
                level = envelope_value(kind, block, n, stride, j, v) + radii[j]
                memory[j] = min(level, memory[j])


@summing
def _weighted(weights, memory):
    total = 0.0
    for j in range(memory.size):
        total += weights[j] * memory[j]
    return total


@exact
def terms_of(packed):
    """The packed memoryless terms (a view)."""
    n = int(packed[0])
    members = 1 if packed[2] == 1.0 else n
    return packed[HEADER + 2 * n + 2 * members * int(packed[3]) :]


@summing
def egpi_output(packed, state):
    """Output of the model in the given state, which stays as it is."""
    n = int(packed[0])
    total = packed[4] + _weighted(packed[HEADER : HEADER + n], state[1 : 1 + n])
    if packed[5] > 0.0:
        total += memoryless_value(terms_of(packed), int(packed[5]), state[0])
    return total


@summing
def egpi_step(v, packed, state):
    """Move the model to the input v and return its output; NaN for a NaN input or a state of the wrong length.

    `packed` and `state` as in the module's docstring; the state is updated in place.
    """
    n = int(packed[0])
    if state.size != n + 1 or v != v:
        return math.nan
    radii = packed[HEADER + n : HEADER + 2 * n]
    memory = state[1:]
    _move(v, state[0], n, int(packed[1]), packed[2] == 1.0, int(packed[3]), packed, radii, memory)
    state[0] = v
    return egpi_output(packed, state)


@summing
def egpi_peek(v, packed, state):
    """Output the model would have after a move to v; the state stays as it is. O(N) scratch memory."""
    return egpi_step(v, packed, state.copy())


@summing
def simulate_many(packed, v, state, out):
    """Run m independent devices: v (m, n) -> out (m, n); state (m, 1+N) holds the initial and then the final one.

    Radii, weights and memory are copied into arrays padded to whole vector registers with plays of
    weight zero, so that no play is left for a slow scalar remainder.
    """
    n = int(packed[0])
    padded = (n + 7) // 8 * 8
    weights = np.zeros(padded)
    radii = np.zeros(padded)
    memory = np.zeros(padded)
    weights[:n] = packed[HEADER : HEADER + n]
    radii[:n] = packed[HEADER + n : HEADER + 2 * n]
    kind = int(packed[1])
    shared = packed[2] == 1.0
    stride = int(packed[3])
    bias = packed[4]
    count = int(packed[5])
    terms = terms_of(packed)
    used = memory if shared else memory[:n]
    for i in range(v.shape[0]):
        memory[:n] = state[i, 1:]
        memory[n:] = 0.0
        previous = state[i, 0]
        for k in range(v.shape[1]):
            now = v[i, k]
            _move(now, previous, n, kind, shared, stride, packed, radii, used)
            previous = now
            total = bias + _weighted(weights, memory)
            if count > 0:
                total += memoryless_value(terms, count, now)
            out[i, k] = total
        state[i, 0] = previous
        state[i, 1:] = memory[:n]


@summing
def play_outputs(packed, v, state, out):
    """Outputs of every play: v (n,) -> out (n, N); the state (1+N,) is updated in place."""
    n = int(packed[0])
    radii = packed[HEADER + n : HEADER + 2 * n]
    memory = state[1:]
    kind = int(packed[1])
    for k in range(v.size):
        _move(v[k], state[0], n, kind, packed[2] == 1.0, int(packed[3]), packed, radii, memory)
        state[0] = v[k]
        out[k, :] = memory


@exact
def order_excess(packed, low, high, points):
    """Largest gamma_R(v) - gamma_L(v) - 2 r over the plays and a grid of inputs, with its input and play."""
    n = int(packed[0])
    kind = int(packed[1])
    shared = packed[2] == 1.0
    stride = int(packed[3])
    members = 1 if shared else n
    start = HEADER + 2 * n
    rising = packed[start : start + members * stride]
    falling = packed[start + members * stride : start + 2 * members * stride]
    worst = -math.inf
    place = low
    which = 0
    for k in range(points):
        v = low + (high - low) * k / max(points - 1, 1)
        for j in range(members):
            gap = envelope_value(kind, rising, members, stride, j, v)
            gap -= envelope_value(kind, falling, members, stride, j, v)
            # radii are sorted: with shared envelopes the first play is the critical one
            excess = gap - 2.0 * packed[HEADER + n + j]
            if excess > worst:
                worst = excess
                place = v
                which = j
    return worst, place, which
