"""Figures of Preisach identification and compression: compressive sensing, least squares, partitions."""

from __future__ import annotations

from statistics import median
from time import perf_counter, process_time

import numpy as np
from scipy.optimize import nnls
from vo2_models.hysteresis.preisach import (
    PreisachOperator,
    compress,
    fit_preisach,
    fit_smooth,
    signed_area_matrix,
)
from vo2_models.identification.excitation import damped_oscillation, first_order_reversal_fan, random_levels

from vo2_studies.bench.entry import Entry, Figure
from vo2_studies.bench.timing import alternate
from vo2_studies.preisach.compressive_sensing import identify_preisach_compressed

__all__ = ["ENTRIES"]


def _recording(level: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Walls, damped oscillation and its noisy outputs, as section 4.3: densities on [0, 12], noise on [-5, 5]."""
    rng = np.random.default_rng(seed)
    walls = np.arange(level + 1.0)
    v = damped_oscillation(walls)
    u = PreisachOperator(walls, rng.uniform(0, 12, level * (level + 1) // 2), 0.0, "square")(v)
    return walls, v, u + rng.uniform(-5, 5, v.size)


def compressive() -> Figure:
    """One run of CS Order Non-negative with 300 of 466 outputs, level 30."""
    walls, v, u = _recording(30)
    rows = np.sort(np.random.default_rng(1).choice(v.size, 300, replace=False))
    order = np.argsort(u)

    def run() -> float:
        _, detail = identify_preisach_compressed(
            u[rows], rows, walls, order=order, nonnegative=True, diagonal="square"
        )
        return detail.gap

    (seconds,) = alternate(run, repeats=7)
    return Figure(seconds, "s", note=f"duality gap {run():.0e}")


def _least_squares(level: int, with_yardstick: bool) -> Figure:
    walls, v, u = _recording(level)
    found = fit_preisach(v, u, walls, diagonal="square")
    matrix = signed_area_matrix(v, walls, diagonal="square")
    gradient = matrix.T @ found.residual
    density = found.operator.parameters[:-1]
    violation = max(float(np.max(gradient[:-1])), float(np.max(np.abs(gradient[:-1][density > 0]))))
    relative = violation / float(np.linalg.norm(matrix) * np.linalg.norm(u))
    if not relative < 1e-10:
        raise RuntimeError(f"least squares: found a gradient of {relative:.1e}, need an optimum to 1e-10")
    (seconds,) = alternate(lambda: fit_preisach(v, u, walls, diagonal="square"), repeats=7)
    note = f"optimal to {relative:.0e}"
    if not with_yardstick:
        return Figure(seconds, "s", note=note)
    wide = np.hstack([matrix, -matrix[:, -1:]])
    start = perf_counter()
    _, norm = nnls(wide, u)
    theirs = perf_counter() - start
    if not abs(norm - float(np.linalg.norm(found.residual))) < 1e-8 * norm:
        raise RuntimeError("yardstick: scipy's nnls found another residual, need the same optimum")
    return Figure(seconds, "s", theirs, f"scipy nnls; {note}")


def _general_input(level: int, repeats: int) -> Figure:
    """A recording that no exact inverse covers: a fan of reversal curves, then as many random levels."""
    rng = np.random.default_rng(2)
    walls = np.arange(level + 1.0)
    cells = level * (level + 1) // 2
    fan = first_order_reversal_fan(walls)
    v = np.concatenate([fan, random_levels(0.0, float(level), fan.size, seed=rng)])
    u = PreisachOperator(walls, rng.uniform(0, 12, cells), 0.0, "square")(v) + rng.uniform(-5, 5, v.size)
    coarse = np.tile(first_order_reversal_fan(walls[:4]), 2)
    fit_preisach(coarse, np.zeros(coarse.size), walls[:4])  # compiles
    seconds = []
    for _ in range(repeats):
        start = perf_counter()
        found = fit_preisach(v, u, walls, diagonal="square")
        seconds.append(perf_counter() - start)
    matrix = signed_area_matrix(v, walls, diagonal="square")
    gradient = matrix.T @ found.residual
    held = found.operator.parameters[:-1] == 0.0
    worst = max(float(np.max(gradient[:-1])), float(np.max(np.abs(gradient[:-1][~held]))))
    relative = worst / float(np.linalg.norm(matrix) * np.linalg.norm(u))
    if not relative < 1e-10:
        raise RuntimeError(f"least squares: found a gradient of {relative:.1e}, need an optimum to 1e-10")
    return Figure(
        median(seconds), "s", note=f"{v.size} samples, {held.sum()} densities at 0; optimal to {relative:.0e}"
    )


def _compression(level: int) -> Figure:
    rng = np.random.default_rng(0)
    walls = np.linspace(30.0, 80.0, 41)
    middle = 0.5 * (walls[1:] + walls[:-1])
    bump = np.exp(-(((middle[:, None] - 58) / 4) ** 2) - ((middle[None, :] - 52) / 4) ** 2)
    operator = PreisachOperator(walls, np.tril((bump + 0.01) * rng.uniform(0.7, 1.3, bump.shape)))
    (seconds,) = alternate(lambda: compress(operator, level, "kl"), repeats=3)
    return Figure(seconds, "s", note="J_KL, every partition compared")


def _smooth(samples: int, level: int, repeats: int) -> Figure:
    """Non-negative smooth density with its strength by five folds, from a damped oscillation at 1 % noise."""
    x = np.linspace(0.0, 1.0, samples)
    v = 1.0 + (1.0 - 0.9 * x) * np.cos(2 * np.pi * max(samples / 250.0, 3.0) * x)
    high, low = np.tril_indices(40)
    law = PreisachOperator(np.linspace(0.0, 2.0, 41), np.exp(-0.5 * ((high - low - 6) / 4) ** 2))
    u = law(v)
    u = u + 0.01 * np.ptp(u) * np.random.default_rng(5).standard_normal(samples)
    walls = np.linspace(0.0, 2.0, level + 1)
    found = fit_smooth(v, u, walls)
    left = float(np.std(found.residual) / np.ptp(u))
    if not left < 0.02:
        raise RuntimeError(f"fit_smooth: left {left:.2g} of the span, need less than 0.02 at a noise of 0.01")
    start = process_time()
    (seconds,) = alternate(lambda: fit_smooth(v, u, walls), repeats=repeats)
    used = (process_time() - start) / (repeats + 1)
    return Figure(seconds, "s", note=f"{samples} samples, L = {level}, {used:.2g} s of processor")


ENTRIES = (
    Entry("fit_smooth_61", lambda: _smooth(61, 30, 5), target=1.0),
    Entry("fit_smooth_10000", lambda: _smooth(10_000, 60, 1), target=10.0),
    Entry("cs_l30", compressive, 0.1),
    Entry("nnls_l30", lambda: _least_squares(30, True), 0.03),
    Entry("nnls_l100", lambda: _least_squares(100, False), 15.0),
    Entry("nnls_l30_general", lambda: _general_input(30, 7), 0.03),
    Entry("nnls_l100_general", lambda: _general_input(100, 1), 15.0),
    Entry("preisach_compress_40_4", lambda: _compression(4), 0.1),
    Entry("preisach_compress_40_8", lambda: _compression(8), 60.0),
)
