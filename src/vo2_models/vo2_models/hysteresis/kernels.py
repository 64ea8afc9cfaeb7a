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

from vo2_models.hysteresis.layout import HEADER, LINEAR, POLYNOMIAL, SINE, TANH
from vo2_models.numerics.kernel import kernel

CHUNK = 256
"""Samples whose envelope values are computed ahead of the plays; small enough for the first-level cache."""
# Reassociation lets the weighted sum over the plays use vector registers; it changes results by rounding only.
summing = kernel(fastmath={"reassoc", "nsz", "contract"})
exact = kernel
# What runs once per play or per sample goes into its caller's loop: a call costs as much as the arithmetic.
summing_inline = kernel(fastmath={"reassoc", "nsz", "contract"}, forceinline=True)
exact_inline = kernel(forceinline=True)


@exact_inline
def tanh(x):
    """Hyperbolic tangent to 2e-16 *absolute*, monotone, at a third of the library function's time.

    The library function spends its time on the relative accuracy of values near zero, which a sum over plays loses.
    """
    return 1.0 - 2.0 / (math.exp(2.0 * x) + 1.0)


@exact
def table_value(inputs, outputs, v):
    """Piecewise-linear function through strictly increasing knots, with its end slopes outside."""
    k = np.searchsorted(inputs, v) - 1
    k = min(max(k, 0), inputs.size - 2)
    slope = (outputs[k + 1] - outputs[k]) / (inputs[k + 1] - inputs[k])
    return outputs[k] + slope * (v - inputs[k])


@exact_inline
def envelope_value(kind, block, members, stride, j, v):
    """Envelope j of a block of `members` envelopes at the input v."""
    if kind == LINEAR:
        return block[j] * v + block[members + j]
    if kind == TANH:
        return tanh(block[j] * v + block[members + j])
    knots = stride // 2
    table = block[j * stride : (j + 1) * stride]
    return table_value(table[:knots], table[knots:], v)


@exact
def envelope_slope(kind, block, members, stride, j, v):
    """Derivative of envelope j at the input v (of the segment to the right at a knot)."""
    if kind == LINEAR:
        return block[j]
    if kind == TANH:
        g = tanh(block[j] * v + block[members + j])
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
        return (0.5 * math.log((1.0 + g) / (1.0 - g)) - block[members + j]) / block[j]
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
            value = terms[at + 2] * tanh(terms[at + 3] * v + terms[at + 4])
        total += value
        at += 2 + size
    return total


@summing_inline
def _follow(direction, level, radii, weights, memory):
    """Move every play of a shared envelope and return the weighted sum of the plays.

    The falling play is the rising one with signs changed, so one branch-free loop serves both: `direction` is 1 or
    -1 and `level` is direction * gamma(v), or -inf where the input stands still.
    """
    total = 0.0
    for j in range(memory.size):
        reached = level - radii[j]
        held = direction * memory[j]
        held = direction * (reached if reached > held else held)
        memory[j] = held
        total += weights[j] * held
    return total


@summing_inline
def _follow_own(direction, moves, v, kind, stride, block, radii, weights, memory):
    """Like `_follow` with one envelope per play."""
    total = 0.0
    for j in range(memory.size):
        held = memory[j]
        if moves:
            reached = direction * envelope_value(kind, block, memory.size, stride, j, v) - radii[j]
            held *= direction
            held = direction * (reached if reached > held else held)
            memory[j] = held
        total += weights[j] * held
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
    total = packed[4]
    for j in range(n):
        total += packed[HEADER + j] * state[1 + j]
    if packed[5] > 0.0:
        total += memoryless_value(terms_of(packed), int(packed[5]), state[0])
    return total


@exact
def _levels(kind, rising, falling, stride, v, previous, directions, levels):
    """Direction and directed envelope value, as `_follow` takes them, of every input v (n,); returns the last v."""
    for k in range(v.size):
        now = v[k]
        if now > previous:
            directions[k] = 1.0
            levels[k] = envelope_value(kind, rising, 1, stride, 0, now)
        elif now < previous:
            directions[k] = -1.0
            levels[k] = -envelope_value(kind, falling, 1, stride, 0, now)
        else:
            directions[k] = -1.0
            levels[k] = -math.inf
        previous = now
    return previous


@summing
def _follow_levels(directions, levels, radii, weights, memory, out):
    """`_follow` along a sequence: one tight loop, free of the kinds of envelope."""
    for k in range(out.size):
        out[k] = _follow(directions[k], levels[k], radii, weights, memory)


@summing
def sweep_egpi(v, packed, state, out):
    """Run one device: v (n,) -> out (n,); the state (1+N,) is updated in place."""
    n = int(packed[0])
    kind = int(packed[1])
    stride = int(packed[3])
    bias = packed[4]
    count = int(packed[5])
    terms = terms_of(packed)
    # copies, because the compiler then knows that writing the memory changes no radius and no weight
    weights = packed[HEADER : HEADER + n].copy()
    radii = packed[HEADER + n : HEADER + 2 * n].copy()
    memory = state[1:].copy()
    shared = packed[2] == 1.0
    members = 1 if shared else n
    start = HEADER + 2 * n
    rising = packed[start : start + members * stride]
    falling = packed[start + members * stride : start + 2 * members * stride]
    previous = state[0]
    if shared:
        directions = np.empty(CHUNK)
        levels = np.empty(CHUNK)
        for first in range(0, v.size, CHUNK):
            last = min(first + CHUNK, v.size)
            size = last - first
            previous = _levels(kind, rising, falling, stride, v[first:last], previous, directions, levels)
            _follow_levels(directions[:size], levels[:size], radii, weights, memory, out[first:last])
    else:
        for k in range(v.size):
            now = v[k]
            up = now > previous
            out[k] = _follow_own(
                1.0 if up else -1.0, now != previous, now, kind, stride, rising if up else falling, radii, weights, memory
            )  # fmt: skip
            previous = now
    state[0] = previous
    state[1:] = memory
    for k in range(v.size):
        out[k] += bias
        if count > 0:
            out[k] += memoryless_value(terms, count, v[k])


@summing
def egpi_step(v, packed, state):
    """Move the model to the input v and return its output; NaN for a NaN input or a state of the wrong length.

    `packed` and `state` as in the module's docstring; the state is updated in place.
    """
    n = int(packed[0])
    if state.size != n + 1 or v != v:
        return math.nan
    kind = int(packed[1])
    stride = int(packed[3])
    weights = packed[HEADER : HEADER + n]
    radii = packed[HEADER + n : HEADER + 2 * n]
    memory = state[1:]
    up = v > state[0]
    moves = v != state[0]
    direction = 1.0 if up else -1.0
    start = HEADER + 2 * n
    if packed[2] == 1.0:
        block = packed[start : start + stride] if up else packed[start + stride : start + 2 * stride]
        level = direction * envelope_value(kind, block, 1, stride, 0, v) if moves else -math.inf
        total = _follow(direction, level, radii, weights, memory)
    else:
        size = n * stride
        block = packed[start : start + size] if up else packed[start + size : start + 2 * size]
        total = _follow_own(direction, moves, v, kind, stride, block, radii, weights, memory)
    state[0] = v
    if packed[5] > 0.0:
        total += memoryless_value(terms_of(packed), int(packed[5]), v)
    return total + packed[4]


@summing
def move_egpi(v, packed, memory, make):
    """The law's compiled step, see `hysteresis.law`: `egpi_step`, on a copy of the memory where the move is not made."""
    return egpi_step(v, packed, memory if make else memory.copy())


@summing
def simulate_many(packed, v, state, out):
    """Run m independent devices: v (m, n) -> out (m, n); state (m, 1+N) holds the initial and then the final one."""
    for i in range(v.shape[0]):
        sweep_egpi(v[i], packed, state[i], out[i])


@summing
def play_outputs(packed, v, state, out):
    """Outputs of every play: v (n,) -> out (n, N); the state (1+N,) is updated in place."""
    for k in range(v.size):
        egpi_step(v[k], packed, state)
        out[k, :] = state[1:]


@exact
def order_excess(packed, low, high, points):
    """Largest gamma_R(v) - gamma_L(v) - 2 r over the plays and a grid of inputs, with its input and play.

    Plays of weight zero do not count: they have no part in the output. -inf where no play has a weight.
    """
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
    # radii are sorted: with a shared pair the first play that counts is the critical one
    first = 0
    while first < n and packed[HEADER + first] == 0.0:
        first += 1
    which = min(first, n - 1)
    if first == n:
        return worst, place, which
    for k in range(points):
        v = low + (high - low) * k / max(points - 1, 1)
        for j in range(first, first + 1 if shared else n):
            if packed[HEADER + j] == 0.0:
                continue
            pair = 0 if shared else j
            gap = envelope_value(kind, rising, members, stride, pair, v)
            gap -= envelope_value(kind, falling, members, stride, pair, v)
            excess = gap - 2.0 * packed[HEADER + n + j]
            if excess > worst:
                worst = excess
                place = v
                which = j
    return worst, place, which
