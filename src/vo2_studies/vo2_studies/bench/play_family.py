"""Figures of the play family: batch against plain C, streaming, inverses, memory."""

from __future__ import annotations

import ctypes
import tracemalloc

import numpy as np
from vo2_models.hysteresis import CPI, EGPI, GPI, Linear, RobustInverse, TanhEnvelopes

from vo2_studies.bench.entry import Entry, Figure
from vo2_studies.bench.timing import aligned, alternate, compiled_c, per_call, pointer

__all__ = ["ENTRIES"]

SAMPLES = 200_000

YARDSTICK = """
#include <math.h>
void pi(const double *v, long n, const double *r, const double *p, double *w, int m, double *y) {
    for (long k = 0; k < n; k++) {
        double sum = 0.0;
        for (int j = 0; j < m; j++) {
            double lower = v[k] - r[j], upper = v[k] + r[j], x = w[j];
            x = x < lower ? lower : x;
            x = x > upper ? upper : x;
            w[j] = x;
            sum += p[j] * x;
        }
        y[k] = sum;
    }
}
void gpi(const double *v, long n, double ar, double br, double al, double bl,
         const double *r, const double *p, double *w, int m, double *y) {
    for (long k = 0; k < n; k++) {
        double rising = tanh(ar * v[k] + br), falling = tanh(al * v[k] + bl), sum = 0.0;
        for (int j = 0; j < m; j++) {
            double lower = rising - r[j], upper = falling + r[j], x = w[j];
            x = x < lower ? lower : x;
            x = x > upper ? upper : x;
            w[j] = x;
            sum += p[j] * x;
        }
        y[k] = sum;
    }
}
"""


def _inputs(samples: int = SAMPLES) -> np.ndarray:
    """A slowly modulated oscillation: continuous, with minor loops of every size, in [-2.5, 2.5]."""
    t = np.arange(samples)
    return 2.5 * np.sin(3e-3 * t) * np.cos(1.1e-4 * t)


def _same(ours: np.ndarray, theirs: np.ndarray) -> None:
    gap = float(np.max(np.abs(ours - theirs)))
    if not gap < 1e-9:
        raise RuntimeError(f"yardstick: found outputs {gap:.3g} apart from ours, need the same computation")


def pi_batch() -> Figure:
    """30 classical plays over a sequence."""
    n = 30
    model = CPI(np.arange(n) / n, np.linspace(1.5, 0.5, n) / n)
    v, out = aligned(_inputs()), aligned(np.empty(SAMPLES))
    radii, weights = aligned(model.radii), aligned(model.weights)
    start = model.initial_state(v=v[0], memory=np.zeros(n))
    memory = aligned(np.zeros(n))
    with compiled_c(YARDSTICK) as library:

        def theirs() -> None:
            memory[:] = start[1:]
            library.pi(
                pointer(v),
                ctypes.c_long(v.size),
                pointer(radii),
                pointer(weights),
                pointer(memory),
                n,
                pointer(out),
            )

        ours, c = alternate(lambda: model.simulate(v, start), theirs)
        _same(model.simulate(v, start)[0], out)
    return Figure(ours / v.size * 1e9, "ns", c / v.size * 1e9, "yardstick: plain C")


def gpi_batch() -> Figure:
    """30 tanh plays over a sequence."""
    n = 30
    envelopes = TanhEnvelopes(1.1, -0.4, 1.1, 0.3)
    model = GPI(np.arange(n) / n, np.linspace(1.5, 0.5, n) / n, envelopes, input_range=(-3, 3))
    v, out = aligned(_inputs()), aligned(np.empty(SAMPLES))
    radii, weights = aligned(model.radii), aligned(model.weights)
    start = model.initial_state(v=v[0])
    memory = aligned(np.zeros(n))
    numbers = (
        envelopes.rising_slope,
        envelopes.rising_offset,
        envelopes.falling_slope,
        envelopes.falling_offset,
    )
    arguments = [ctypes.c_double(float(x)) for x in numbers]
    with compiled_c(YARDSTICK) as library:

        def theirs() -> None:
            memory[:] = start[1:]
            library.gpi(
                pointer(v),
                ctypes.c_long(v.size),
                *arguments,
                pointer(radii),
                pointer(weights),
                pointer(memory),
                n,
                pointer(out),
            )

        ours, c = alternate(lambda: model.simulate(v, start), theirs)
        _same(model.simulate(v, start)[0], out)
    return Figure(ours / v.size * 1e9, "ns", c / v.size * 1e9, "yardstick: plain C")


def deflection_model() -> EGPI:
    """Six plays with an envelope pair each and a falling linear part, as in Table 7.2 (order of its plays mended).

    Input in mA, output in um; play 4's falling offset is raised by 0.1 and the weights are the table's.
    """
    rising_slope = np.array([1202.6, 1376.2, 1243.0, 1173.7, 788.8, 788.8]) * 1e-3
    falling_slope = np.array([982.5, 1754.8, 2169.2, 838.1, 1864.7, 1623.2]) * 1e-3
    rising_offset = [-8.67, -12.15, -10.12, -7.42, -10.83, -11.21]
    falling_offset = [-6.49, -11.13, -11.56, -6.14, -6.46, -15.52]
    weights = [27.24, 5.35, 3.18, 12.84, 1.00, 26.68]
    envelopes = TanhEnvelopes(rising_slope, rising_offset, falling_slope, falling_offset)
    return EGPI(
        np.arange(6) / 6,
        weights,
        envelopes,
        Linear(-8.8743),
        143.29,
        input_range=(3.68, 8.49),
    )


def resistance_model() -> GPI:
    """Six plays with a shared pair, after Table 7.1: input mA, output minus resistance in 100 kohm.

    The falling offset is raised so that the envelopes keep their order over the operating range.
    """
    envelopes = TanhEnvelopes(0.6249, -3.656, 0.5197, -2.75)
    return GPI(
        np.arange(6) / 6, [0.415, 0.648, 0.325, 0, 0.081, 0.618], envelopes, 1.3256, input_range=(3.68, 8.49)
    )


def _currents(samples: int) -> np.ndarray:
    """Inputs over the operating range 3.68 to 8.49 mA with minor loops of every size."""
    return 6.085 + 2.4 * _inputs(samples) / 2.5


def egpi_stream() -> Figure:
    """One sample of a 6-play EGPI from Python."""
    model = deflection_model()
    values = _currents(5000).tolist()
    state = model.initial_state(v=3.68)
    return Figure(per_call(lambda v: model.update(v, state), values) * 1e6, "us")


def composite_stream() -> Figure:
    """One self-sensing sample from Python: resistance -> inverse GPI -> current -> EGPI -> deflection, 6 plays each."""
    forward, deflection = resistance_model(), deflection_model()
    inverse = RobustInverse(forward)
    values = forward.simulate(_currents(5000), forward.initial_state(v=3.68))[0].tolist()
    inner, outer = forward.initial_state(v=3.68), deflection.initial_state(v=3.68)
    seconds = per_call(lambda y: deflection.update(inverse.update(y, inner), outer), values)
    return Figure(seconds * 1e6, "us")


def egpi_inverse() -> Figure:
    """Non-monotone 6-play EGPI with an envelope pair per play, inverted over a sequence."""
    model = deflection_model()
    inverse = RobustInverse(model)
    start = model.initial_state(v=3.68)
    wishes, _ = model.simulate(_currents(20_000), start)
    result = inverse.simulate(wishes, start)
    residual = np.max(np.abs(result.output - wishes)[result.reached]) / inverse.output_range
    (seconds,) = alternate(lambda: inverse.simulate(wishes, start))
    note = f"residual {residual:.1e} of range, {np.mean(result.reached):.1%} reachable on the way taken"
    return Figure(seconds / wishes.size * 1e6, "us", note=note)


def batch_arrays() -> Figure:
    """Peak memory of a 10-million-sample batch, in arrays of its size, the input included."""
    samples = 10_000_000
    model = GPI(np.arange(30) / 30, np.ones(30), TanhEnvelopes(1.1, -0.4, 1.1, 0.3))
    model.simulate(np.zeros(2))
    tracemalloc.start()
    v = np.sin(np.arange(samples, dtype=np.float64))
    tracemalloc.reset_peak()
    model.simulate(v)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return Figure(peak / (8 * samples), "arrays")


ENTRIES = (
    Entry("pi30_batch", pi_batch, 1.5, "ratio"),
    Entry("gpi30_batch", gpi_batch, 1.3, "ratio"),
    Entry("egpi6_stream", egpi_stream, 3.0),
    Entry("composite6_stream", composite_stream, 5.0),
    Entry("egpi6_inverse", egpi_inverse, 2.0),
    Entry("gpi_batch_10m_memory", batch_arrays, 3.0),
)
