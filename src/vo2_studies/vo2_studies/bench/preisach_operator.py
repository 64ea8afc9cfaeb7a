"""Figures of the Preisach operator: batch against a plain C loop over the Everett table, streaming, inverse."""

from __future__ import annotations

import ctypes
import tracemalloc

import numpy as np
from vo2_models.hysteresis.preisach import PreisachInverse, PreisachOperator

from vo2_studies.bench.entry import Entry, Figure
from vo2_studies.bench.timing import aligned, alternate, compiled_c, per_call, pointer

__all__ = ["ENTRIES"]

SAMPLES = 400_000

YARDSTICK = """
void everett(const double *v, long n, const double *table, long level, const double *half, double low, double width,
             double lowest, double *turn, double *at, double *out) {
    double inverse = 1.0 / width, now = low, u = lowest;
    long m = 1, row = 0;
    double share = 0.0, parabola = 0.0;
    turn[0] = low;
    at[0] = lowest;
    for (long k = 0; k < n; k++) {
        double x = v[k];
        if (x != now) {
            long before = m;
            if ((x > now) != (m & 1)) {
                turn[m] = now;
                at[m++] = u;
            }
            if (x > now)
                while (m >= 3 && x >= turn[m - 2]) m -= 2;
            else {
                while (m >= 4 && x <= turn[m - 2]) m -= 2;
                if (m == 2 && x <= low) m = 1;
            }
            if (m != before) {
                double y = (turn[m - 1] - low) * inverse;
                row = (long)y;
                if (row > level - 1) row = level - 1;
                share = y - row;
                y = share * width;
                parabola = half[row] * y * (y - width);
            }
            double z = (x - low) * inverse;
            long column = (long)z;
            if (column > level - 1) column = level - 1;
            z -= column;
            const double *a = table + row * (level + 1) + column, *b = a + level + 1;
            double left = (1.0 - share) * a[0] + share * b[0], right = (1.0 - share) * a[1] + share * b[1];
            double t = z * width;
            double e = left + (right - left) * z + parabola + half[column] * t * (t - width);
            u = at[m - 1] + (m & 1 ? 2.0 : -2.0) * e;
            now = x;
        }
        out[k] = u;
    }
}
"""


def _inputs(samples: int = SAMPLES) -> np.ndarray:
    """Continuous, with minor loops of every size, in (0, 1): 20 000 samples an oscillation, as 1 kHz at 0.05 Hz."""
    t = np.arange(samples)
    return 0.5 + 0.5 * np.sin(2 * np.pi * t / 20_000) * np.cos(1.1e-5 * t)


def _operator(level: int) -> PreisachOperator:
    rng = np.random.default_rng(level)
    return PreisachOperator(np.linspace(0.0, 1.0, level + 1), rng.random(level * (level + 1) // 2))


def _batch(level: int) -> Figure:
    operator = _operator(level)
    v, out = aligned(_inputs()), aligned(np.empty(SAMPLES))
    table, walls, half, _, _ = operator.compiled
    table, half = aligned(table), aligned(half)
    turn, at = aligned(np.empty(10_000)), aligned(np.empty(10_000))
    with compiled_c(YARDSTICK) as library:

        def theirs() -> None:
            library.everett(
                pointer(v),
                ctypes.c_long(v.size),
                pointer(table),
                ctypes.c_long(level),
                pointer(half),
                ctypes.c_double(walls[0]),
                ctypes.c_double(1.0 / level),
                ctypes.c_double(operator.output_range[0]),
                pointer(turn),
                pointer(at),
                pointer(out),
            )

        ours, yardstick = alternate(lambda: operator(v), theirs)
        gap = float(np.max(np.abs(operator(v) - out)))
    if not gap < 1e-9 * np.ptp(operator.output_range):
        raise RuntimeError(f"yardstick: found outputs {gap:.3g} apart from ours, need the same computation")
    return Figure(ours / SAMPLES * 1e9, "ns", yardstick / SAMPLES * 1e9, "plain C over the Everett table")


def level_ratio() -> Figure:
    """Cost of a sample at level 1000 over that at level 30, the same input."""
    v = aligned(_inputs())
    fine, coarse = _operator(1000), _operator(30)
    ours, yardstick = alternate(lambda: fine(v), lambda: coarse(v))
    return Figure(ours / SAMPLES * 1e9, "ns", yardstick / SAMPLES * 1e9, "level 1000 over level 30")


def stream() -> Figure:
    """One sample of a level-100 operator from Python."""
    operator = _operator(100)
    state = operator.initial_memory()
    values = _inputs(200_000)[::40].tolist()
    return Figure(per_call(lambda v: operator.step(v, state), values) * 1e6, "us")


def inverse() -> Figure:
    """One desired output of a level-100 operator to its input, from Python; outputs at random, far apart."""
    operator = _operator(100)
    solver, state = PreisachInverse(operator), operator.initial_memory()
    low, high = operator.output_range
    wishes = np.random.default_rng(0).uniform(low, high, 4000)
    v, reached = solver.run(wishes, operator.initial_memory())
    residual = float(np.max(np.abs(operator(v) - wishes)) / (high - low))
    if not (reached.all() and residual <= 1e-9):
        raise RuntimeError(f"inverse: found a residual of {residual:.1e} of the range, need at most 1e-9")
    seconds = per_call(lambda u: solver.update(u, state), wishes.tolist())
    return Figure(seconds * 1e6, "us", note=f"residual {residual:.1e} of range")


def batch_arrays() -> Figure:
    """Peak memory of a 10-million-sample batch, in arrays of its size, the input included."""
    samples = 10_000_000
    operator = _operator(100)
    operator(np.zeros(2))
    tracemalloc.start()
    v = np.sin(np.arange(samples, dtype=np.float64))
    tracemalloc.reset_peak()
    operator(v)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return Figure(peak / (8 * samples), "arrays")


ENTRIES = (
    Entry("preisach30_batch", lambda: _batch(30), 2.0, "ratio"),
    Entry("preisach100_batch", lambda: _batch(100), 2.0, "ratio"),
    Entry("preisach1000_batch", lambda: _batch(1000), 2.0, "ratio"),
    Entry("preisach1000_over_30", level_ratio, 1.3, "ratio"),
    Entry("preisach100_stream", stream, 3.0),
    Entry("preisach100_inverse", inverse, 10.0),
    Entry("preisach_batch_10m_memory", batch_arrays, 3.0),
)
