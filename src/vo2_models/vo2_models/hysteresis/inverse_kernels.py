"""Compiled inversion of a packed play model: the input nearest to the present one that gives a wanted output.

On either side of the present input the output is a known function of the next input: play j keeps its value
until its envelope reaches it, and follows the envelope from there. Between such thresholds

    f(v) = c + sum_{active j} p_j gamma_j(v) + D(v)

is smooth, and every interval [a, b] with midpoint m and width h is judged by Taylor bounds with a bound K on |f''|:
it holds no solution if |f(m) - u| > |f'(m)| h/2 + K h^2/8; f is strictly monotone on it if |f'(m)| > K h/2, and then a
sign change at the ends brackets exactly one; else it is halved. Nothing is sampled, so no solution is overlooked.

    inverse = [low, high, tolerance, monotone, packed...]     packed and state as in `kernels`
"""

from __future__ import annotations

import math

import numpy as np

from vo2_models.hysteresis.kernels import (
    egpi_output,
    egpi_step,
    envelope_inverse,
    envelope_slope,
    envelope_value,
    exact,
    tanh,
    terms_of,
)
from vo2_models.hysteresis.layout import HEADER, POLYNOMIAL, SINE, TABLE, TANH

SETTINGS = 4
NEAREST = 100.0
"""Coarser tolerance by which an output is nearer than another: 1e-10 of the range instead of the solver's 1e-12."""
TANH_CURVATURE = 4.0 / (3.0 * math.sqrt(3.0))
"""Largest |tanh''|."""


@exact
def memoryless_pair(terms, count, v):
    """Value and slope of the packed memoryless terms."""
    value = 0.0
    slope = 0.0
    at = 0
    for _ in range(count):
        kind = int(terms[at])
        size = int(terms[at + 1])
        if kind == POLYNOMIAL:
            p = 0.0
            d = 0.0
            for k in range(size - 1, -1, -1):
                d = d * v + p
                p = p * v + terms[at + 2 + k]
            value += p
            slope += d
        elif kind == SINE:
            angle = terms[at + 3] * v + terms[at + 4]
            value += terms[at + 2] * math.sin(angle)
            slope += terms[at + 2] * terms[at + 3] * math.cos(angle)
        else:
            g = tanh(terms[at + 3] * v + terms[at + 4])
            value += terms[at + 2] * g
            slope += terms[at + 2] * terms[at + 3] * (1.0 - g) * (1.0 + g)
        at += 2 + size
    return value, slope


@exact
def memoryless_curvature(terms, count, reach):
    """Upper bound of |D''| for |v| <= reach."""
    bound = 0.0
    at = 0
    for _ in range(count):
        kind = int(terms[at])
        size = int(terms[at + 1])
        if kind == POLYNOMIAL:
            power = 1.0
            for k in range(2, size):
                bound += k * (k - 1) * abs(terms[at + 2 + k]) * power
                power *= reach
        elif kind == SINE:
            bound += abs(terms[at + 2]) * terms[at + 3] ** 2
        else:
            bound += abs(terms[at + 2]) * terms[at + 3] ** 2 * TANH_CURVATURE
        at += 2 + size
    return bound


@exact
def _evaluate(v, packed, block, members, constant, weight, active, order):
    """Value and slope of f with the plays order[:active] active; `weight` is their total."""
    kind = int(packed[1])
    stride = int(packed[3])
    count = int(packed[5])
    value = constant
    slope = 0.0
    if packed[2] == 1.0:
        g = envelope_value(kind, block, 1, stride, 0, v)
        dg = (
            block[0] * (1.0 - g) * (1.0 + g) if kind == TANH else envelope_slope(kind, block, 1, stride, 0, v)
        )
        value += weight * g
        slope += weight * dg
    else:
        for k in range(active):
            j = order[k]
            p = packed[HEADER + j]
            g = envelope_value(kind, block, members, stride, j, v)
            value += p * g
            if kind == TANH:
                slope += p * block[j] * (1.0 - g) * (1.0 + g)
            else:
                slope += p * envelope_slope(kind, block, members, stride, j, v)
    if count > 0:
        d, dd = memoryless_pair(terms_of(packed), count, v)
        value += d
        slope += dd
    return value, slope


@exact
def _root(a, fa, b, fb, u, tolerance, packed, block, members, constant, weight, active, order):
    """Root of f - u between a and b, where f - u changes its sign: Newton, kept inside a shrinking bracket."""
    rising = fb > fa
    below, above = (a, b) if rising else (b, a)
    v = a + (b - a) * (u - fa) / (fb - fa) if fb != fa else a
    before = abs(b - a)
    for _ in range(200):
        f, slope = _evaluate(v, packed, block, members, constant, weight, active, order)
        if abs(f - u) <= 0.1 * tolerance:
            break
        if f < u:
            below = v
        else:
            above = v
        width = abs(above - below)
        if width <= 4e-16 * max(abs(above), abs(below)):
            break
        step = v - (f - u) / slope if slope != 0.0 else math.inf
        inside = min(below, above) < step < max(below, above)
        if not inside or 2.0 * abs(step - v) > before:
            step = 0.5 * (below + above)
        before = abs(step - v)
        v = step
    return v


@exact
def _next_knot(v, end, direction, packed, block):
    """The knot of a table met first on the way from v to end; `end` if there is none."""
    knots = block[: int(packed[3]) // 2]
    if direction > 0:
        k = np.searchsorted(knots, v, side="right")
        return min(end, knots[k]) if k < knots.size else end
    k = np.searchsorted(knots, v) - 1
    return max(end, knots[k]) if k >= 0 else end


@exact
def search_side(direction, start, limit, u, tolerance, monotone, nearest, best, packed, state):
    """Look for f(v) = u from `start` to `limit` (direction 1 up, -1 down).

    Returns found, v, |f(v) - u|: the solution nearest to `start`. Where there is none, found is False, and with
    `nearest` v is the input on this side whose output is nearest to u, or `start` where nothing comes closer than `best`.
    """
    margin = NEAREST * tolerance if nearest else tolerance
    n = int(packed[0])
    kind = int(packed[1])
    shared = packed[2] == 1.0
    stride = int(packed[3])
    members = 1 if shared else n
    first = HEADER + 2 * n + (0 if direction > 0 else members * stride)
    block = packed[first : first + members * stride]
    keys = np.empty(n)
    order = np.empty(n, dtype=np.int64)
    constant = packed[4]
    plays = 0
    for j in range(n):
        p = packed[HEADER + j]
        if p == 0.0:
            continue
        constant += p * state[1 + j]
        level = state[1 + j] + direction * packed[HEADER + n + j]
        key = direction * (level if shared else envelope_inverse(kind, block, members, stride, j, level))
        k = plays
        while k > 0 and keys[k - 1] > key:
            keys[k] = keys[k - 1]
            order[k] = order[k - 1]
            k -= 1
        keys[k] = key
        order[k] = j
        plays += 1

    terms = terms_of(packed)
    count = int(packed[5])
    curvature_d = memoryless_curvature(terms, count, max(abs(start), abs(limit))) if count > 0 else 0.0
    # halving adds one entry a level and ends where the Taylor bound meets the tolerance: far fewer levels than 256
    stack = np.empty((256, 2))
    weight = 0.0
    curvature_g = 0.0
    active = 0
    best_v = start
    a = start
    fa = 0.0
    cut = start
    known_at = start
    known = 0.0
    first_piece = True
    while True:
        # the plays whose thresholds are passed by now, and where the next one waits
        b = limit
        while active < plays:
            at = direction * keys[active]
            if shared:
                at = envelope_inverse(kind, block, 1, stride, 0, at)
            if direction * (at - a) > 0.0:
                if direction * (limit - at) > 0.0:
                    b = at
                break
            j = order[active]
            p = packed[HEADER + j]
            constant -= p * (state[1 + j] + direction * packed[HEADER + n + j])
            weight += p
            if kind == TANH:
                slope = block[0] if shared else block[j]
                curvature_g += abs(p) * slope * slope * TANH_CURVATURE
            active += 1
        if kind == TABLE:
            b = _next_knot(a, b, direction, packed, block)
        if first_piece:
            fa, slope_a = _evaluate(a, packed, block, members, constant, weight, active, order)
            known_at = a
            known = fa
            # a straight line from here would meet u half way to this cut: the root is likely in the short interval
            cut = a + direction * 2.0 * abs(fa - u) / max(abs(slope_a), 1e-300)
            if abs(fa - u) < best - margin:
                best = abs(fa - u)
                best_v = a
            if abs(fa - u) <= tolerance:
                return True, a, abs(fa - u)
        if monotone:
            # f rises with v: the sign at the far end decides
            fb, _ = _evaluate(b, packed, block, members, constant, weight, active, order)
            if abs(fb - u) < best - margin:
                best = abs(fb - u)
                best_v = b
            if (fa - u) * (fb - u) <= 0.0:
                if shared and count == 0 and weight > 0.0:
                    # f is linear in the envelope: (B.13) in closed form, kept in its piece against rounding
                    v = envelope_inverse(kind, block, 1, stride, 0, (u - constant) / weight)
                    return True, min(max(v, min(a, b)), max(a, b)), 0.0
                v = _root(a, fa, b, fb, u, tolerance, packed, block, members, constant, weight, active, order)
                return True, v, 0.0
            fa = fb
        else:
            curvature = curvature_d + curvature_g
            stack[0, 0] = a
            stack[0, 1] = b
            depth = 1
            if first_piece and not nearest and direction * (b - cut) > 0.0:
                stack[0, 0] = cut
                stack[1, 0] = a
                stack[1, 1] = cut
                depth = 2
            while depth > 0:
                depth -= 1
                near = stack[depth, 0]
                far = stack[depth, 1]
                middle = 0.5 * (near + far)
                h = abs(far - near)
                f, slope = _evaluate(middle, packed, block, members, constant, weight, active, order)
                gap = abs(f - u)
                slack = abs(slope) * 0.5 * h + curvature * h * h * 0.125
                if gap < best - margin:
                    best = gap
                    best_v = middle
                # without a solution, an interval is of use only where it may come closer than the best
                if gap > slack + tolerance and (
                    not nearest or gap - slack >= best - margin or slack <= 0.5 * margin
                ):
                    continue
                if slack <= 0.5 * tolerance or h <= 1e-15 * (abs(near) + abs(far)):
                    if gap <= 2.0 * tolerance:
                        return True, middle, gap
                    continue
                if abs(slope) > 0.5 * curvature * h:
                    # f is continuous, so the far end of the interval before serves as this one's near end
                    fn = known
                    if near != known_at:
                        fn, _ = _evaluate(near, packed, block, members, constant, weight, active, order)
                    ff, _ = _evaluate(far, packed, block, members, constant, weight, active, order)
                    known_at = far
                    known = ff
                    if abs(fn - u) < best - margin:
                        best = abs(fn - u)
                        best_v = near
                    if abs(ff - u) < best - margin:
                        best = abs(ff - u)
                        best_v = far
                    # a solution at an end, such as a reversal point revisited, may show no change of sign after rounding
                    if abs(fn - u) <= tolerance:
                        return True, near, abs(fn - u)
                    if (fn - u) * (ff - u) <= 0.0:
                        v = _root(
                            near, fn, far, ff, u, tolerance, packed, block, members, constant, weight, active, order
                        )  # fmt: skip
                        return True, v, 0.0
                    if abs(ff - u) <= tolerance:
                        return True, far, abs(ff - u)
                    continue
                stack[depth, 0] = middle
                stack[depth, 1] = far
                stack[depth + 1, 0] = near
                stack[depth + 1, 1] = middle
                depth += 2
        if b == limit:
            break
        a = b
        first_piece = False
    fb, _ = _evaluate(limit, packed, block, members, constant, weight, active, order)
    gap = abs(fb - u)
    if gap < best - margin or gap <= tolerance < best:
        best = gap
        best_v = limit
    return best <= tolerance, best_v, best


@exact
def solve(u, inverse, state):
    """The input in [low, high] nearest to the present one whose output is u, else the one whose output is nearest.

    The state stays as it is, except that a present input outside [low, high] first enters that range.
    """
    low = inverse[0]
    high = inverse[1]
    tolerance = inverse[2]
    monotone = inverse[3] == 1.0
    packed = inverse[SETTINGS:]
    if state[0] < low:
        egpi_step(low, packed, state)
    elif state[0] > high:
        egpi_step(high, packed, state)
    now = state[0]
    present = egpi_output(packed, state)
    if abs(present - u) <= tolerance:
        return now
    offset = abs(present - u)
    if monotone:
        direction, limit = (1.0, high) if u > present else (-1.0, low)
        return search_side(direction, now, limit, u, tolerance, True, False, offset, packed, state)[1]
    # a solution on the likelier side, searched first, bounds the search on the other one
    first = 1.0 if u > present else -1.0
    near_limit, far_limit = (high, low) if u > present else (low, high)
    found, v, gap = search_side(first, now, near_limit, u, tolerance, False, False, offset, packed, state)
    if found:
        mirrored = now - (v - now)
        far_limit = max(far_limit, mirrored) if first > 0.0 else min(far_limit, mirrored)
        found, other, _ = search_side(
            -first, now, far_limit, u, tolerance, False, False, offset, packed, state
        )
        return other if found and abs(other - now) < abs(v - now) else v
    # there the solution, or else the nearest output: what was looked at so far bounds how near it can be
    found, other, nearer = search_side(-first, now, far_limit, u, tolerance, False, True, gap, packed, state)
    if found:
        return other
    if nearer < gap:
        v, gap = other, nearer
    _, other, nearer = search_side(first, now, near_limit, u, tolerance, False, True, gap, packed, state)
    return other if nearer < gap else v


@exact
def invert_step(u, inverse, state):
    """Move the model to the solution for u: its input and output; NaN for a NaN wish or a state of a wrong length."""
    packed = inverse[SETTINGS:]
    if u != u or state.size != int(packed[0]) + 1:
        return math.nan, math.nan
    v = solve(u, inverse, state)
    return v, egpi_step(v, packed, state)


@exact
def invert_update(u, inverse, state):
    """`invert_step` that returns the input alone, for the shortest way from Python."""
    return invert_step(u, inverse, state)[0]


@exact
def invert_many(u, inverse, state, inputs, outputs):
    """Independent devices: wishes u (m, n) -> inputs and outputs (m, n); state (m, 1+N) is updated in place."""
    for i in range(u.shape[0]):
        for k in range(u.shape[1]):
            inputs[i, k], outputs[i, k] = invert_step(u[i, k], inverse, state[i])
