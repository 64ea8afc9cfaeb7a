"""Preisach fits to measured recordings, judged on what they were not fitted on.

    python -m vo2_studies.preisach.measured_study [--data DIR] [--plots DIR]

Magnetic first-order reversal curves, the whole recording: every other curve is fitted, the rest predicted, at levels from
20 up to cells as fine as the field steps (level 215, 23 220 cells). The measured density is negative in places (hysterons
that interact; a known trait of such curves), which cross-validation on the training curves finds out: it prefers the
signed density at every level where both are tried. Held-out errors in 1e-6 A m^2:

- "nnls": densities >= 0, unregularised, at the optimum (`slope` and `slackness` of `ConstrainedSolution` are printed).
  It cannot even reproduce the curves it was fitted to better than 0.237, however fine the cells;
- "smooth >= 0": regularised, same sign. Over the whole range it gains nothing to speak of: what is left is the sign;
- "smooth": regularised, signed, strength by cross-validation: better by 21 % at level 20 and by 96 % at 215;
- "rough": signed with next to no regularisation: what smoothness contributes beside the sign.

Within three windows of 80 mT that together hold nearly all curves, at cells as fine as the field steps, densities are kept
>= 0 on both sides, so that the gain is smoothness alone: 63 to 65 %. There too the training curves prefer signed
densities (`nonnegative=None`), which would make it 67, 95 and 73 %.
Piezo: fitted on the first 60 per cent, the rest predicted. VO2 film: one sweep up and down, so only every other
sample can be held out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from vo2_models.hysteresis.preisach.everett_rows import everett_rows, node_values
from vo2_models.hysteresis.preisach.interior_point import nonnegative_masses
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.hysteresis.preisach.smooth_fit import STRENGTHS, SmoothFit, fit_smooth

from vo2_studies.preisach.measured import (
    ReversalCurves,
    data_folder,
    read_piezo,
    read_reversal_curves,
    read_voltage_sweep,
)

__all__ = [
    "LEVELS",
    "WINDOWS_T",
    "HeldOut",
    "RangeStudy",
    "magnetic_range_study",
    "magnetic_study",
    "main",
    "piezo_study",
    "sweep_study",
]

Floats = NDArray[np.float64]

WINDOWS_T = ((-0.188, -0.108), (-0.108, -0.028), (-0.028, 0.052))
"""Fields that a fit of the magnetic curves covers [T]."""

LEVELS = (20, 40, 80, 112, 215)
"""Of the fits to the whole recording; the last has cells of the field step between reversals, 1.85 mT."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A fit and what it predicts.

    Attributes
    ----------
    fit : the regularised one
    smooth_rmse, plain_rmse : on the held-out samples, regularised and unregularised (scipy's `nnls`), same level
    noise_rmse : training residual of the regularised fit, for comparison
    output_range : of the held-out samples
    input, output, predicted : held-out samples
    """

    fit: SmoothFit
    smooth_rmse: float
    plain_rmse: float
    noise_rmse: float
    output_range: float
    input: Floats
    output: Floats
    predicted: Floats

    @property
    def gain(self) -> float:
        """Share of the unregularised error that regularisation removes."""
        return 1.0 - self.smooth_rmse / self.plain_rmse


def _held_out(
    v: Floats,
    u: Floats,
    walls: Floats,
    groups: NDArray[np.int64],
    train: NDArray[np.bool_],
    test: NDArray[np.bool_],
    strengths: Sequence[float],
) -> HeldOut:
    fit = fit_smooth(v, u, walls, groups=groups, measured=train, strengths=strengths)
    predicted = fit.operator(v)[test]
    matrix = signed_area_matrix(v, walls)
    # the triangular factor has the same solution as the samples, and fewer rows
    system = np.c_[matrix[train], -matrix[train][:, -1:], u[train]]
    triangle = np.asarray(np.linalg.qr(system, mode="r")) if system.shape[0] > system.shape[1] else system
    w = nnls(triangle[:, :-1], triangle[:, -1], maxiter=100 * triangle.shape[1])[0]
    plain = PreisachOperator(walls, w[:-2], float(w[-2] - w[-1]))(v)[test]
    return HeldOut(
        fit,
        float(np.sqrt(np.mean((predicted - u[test]) ** 2))),
        float(np.sqrt(np.mean((plain - u[test]) ** 2))),
        fit.rmse,
        float(np.ptp(u[test])),
        v[test],
        u[test],
        predicted,
    )


def magnetic_study(
    curves: ReversalCurves,
    window_t: tuple[float, float],
    *,
    level: int = 46,
    strengths: Sequence[float] = STRENGTHS,
) -> HeldOut:
    """Fit every other reversal curve within a window of fields and predict the others [1e-6 A m^2].

    Fields above the window are left out; the hysterons that switch there share one wide cell per column, up to the
    saturation field.
    """
    low, high = window_t
    v: list[float] = []
    u: list[float] = []
    groups: list[int] = []
    used: list[bool] = []
    for field, moment in zip(curves.field_t, curves.moment_am2, strict=True):
        if low <= field[0] <= high:
            inside = field <= high
            number = groups[-1] + 1 if groups else 0
            v += [curves.saturation_t, *field[inside]]
            u += [0.0, *(1e6 * moment[inside])]
            groups += [number] * (1 + int(np.count_nonzero(inside)))
            used += [False] + [True] * int(np.count_nonzero(inside))
    label, known = np.array(groups), np.array(used)
    walls = np.r_[np.linspace(low, high, level), curves.saturation_t]
    even = label % 2 == 0
    return _held_out(np.array(v), np.array(u), walls, label, known & even, known & ~even, strengths)


@dataclass(frozen=True, eq=False)
class RangeStudy:
    """The whole magnetic recording at one level, held-out and training errors [1e-6 A m^2].

    Attributes
    ----------
    level : discretisation level, the wide cell up to saturation included
    plain_rmse, plain_training : unregularised, densities >= 0, on held-out and on training curves
    slope, slackness : how near that fit is to its optimum, see `ConstrainedSolution`
    nonnegative_rmse : regularised, densities >= 0, the strength of `fit`
    rough_rmse : signed, regularised 1e-8 times as much as the least strength tried
    smooth_rmse : `fit` on the held-out curves
    fit : regularised, signed, strength chosen by cross-validation on the training curves
    input, output, predicted : held-out samples [T, 1e-6 A m^2]
    """

    level: int
    plain_rmse: float
    plain_training: float
    slope: float
    slackness: float
    nonnegative_rmse: float
    rough_rmse: float
    smooth_rmse: float
    fit: SmoothFit
    input: Floats
    output: Floats
    predicted: Floats

    @property
    def gain(self) -> float:
        """Share of the error of unregularised non-negative least squares that the regularised fit removes."""
        return 1.0 - self.smooth_rmse / self.plain_rmse


def _path(curves: ReversalCurves) -> tuple[Floats, Floats, NDArray[np.int64], NDArray[np.bool_]]:
    """Fields [T] with the saturation before each curve, moments [1e-6 A m^2], curve of each sample, and which are measured."""
    fields = [np.r_[curves.saturation_t, field] for field in curves.field_t]
    moments = [np.r_[0.0, 1e6 * moment] for moment in curves.moment_am2]
    label = np.repeat(np.arange(len(fields)), [field.size for field in fields])
    measured = np.concatenate([np.arange(field.size) > 0 for field in fields])
    return np.concatenate(fields), np.concatenate(moments), label, measured


def magnetic_range_study(
    curves: ReversalCurves, level: int, *, first: int = 1, strengths: Sequence[float] = STRENGTHS
) -> RangeStudy:
    """Fit every other curve over the whole range of fields, from curve `first` (0 or 1) on, and predict the others.

    Even cells from the lowest reversal to the largest field measured, and a wide one from there to saturation.
    """
    v, u, label, measured = _path(curves)
    low = min(float(field[0]) for field in curves.field_t)
    high = max(float(field.max()) for field in curves.field_t)
    walls = np.r_[np.linspace(low, high, level), curves.saturation_t]
    chosen = label % 2 == first
    train, test = measured & chosen, measured & ~chosen

    def error(operator: PreisachOperator, on: NDArray[np.bool_]) -> float:
        return float(np.sqrt(np.mean((operator(v)[on] - u[on]) ** 2)))

    rows = everett_rows(v, walls)
    plain = nonnegative_masses(rows[train], u[train])
    modelled = plain.constant + rows @ node_values(plain.masses)
    fit = fit_smooth(v, u, walls, nonnegative=False, groups=label, measured=train, strengths=strengths)
    positive = fit_smooth(v, u, walls, groups=label, measured=train, strengths=[fit.strength])
    rough = fit_smooth(
        v, u, walls, nonnegative=False, groups=label, measured=train, strengths=[1e-8 * min(strengths)]
    )
    return RangeStudy(
        level,
        float(np.sqrt(np.mean((modelled - u)[test] ** 2))),
        float(np.sqrt(np.mean((modelled - u)[train] ** 2))),
        plain.slope,
        plain.slackness,
        error(positive.operator, test),
        error(rough.operator, test),
        error(fit.operator, test),
        fit,
        v[test],
        u[test],
        fit.operator(v)[test],
    )


def piezo_study(
    voltage_v: Floats,
    displacement_m: Floats,
    *,
    level: int = 24,
    share: float = 0.6,
    strengths: Sequence[float] = STRENGTHS,
) -> HeldOut:
    """Fit the first part of the piezo recording and predict the rest, with the memory carried over [um]."""
    walls = np.linspace(voltage_v.min() - 1e-6, voltage_v.max() + 1e-6, level + 1)
    train = np.arange(voltage_v.size) < share * voltage_v.size
    blocks = np.arange(voltage_v.size) * 50 // voltage_v.size
    return _held_out(voltage_v, 1e6 * displacement_m, walls, blocks, train, ~train, strengths)


def sweep_study(
    voltage_v: Floats, resistance_ohm: Floats, *, level: int = 24, strengths: Sequence[float] = STRENGTHS
) -> HeldOut:
    """Fit every other sample of the film's sweep and predict the others, -log10(R / ohm)."""
    walls = np.linspace(voltage_v.min() - 1e-6, voltage_v.max() + 1e-6, level + 1)
    index = np.arange(voltage_v.size)
    train = index % 2 == 0
    return _held_out(voltage_v, -np.log10(resistance_ohm), walls, index // 2, train, ~train, strengths)


def _plot(folder: Path, name: str, study: HeldOut | RangeStudy, x: str, y: str) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    left.plot(study.input, study.output, ".", markersize=2, label="measured, held out")
    left.plot(study.input, study.predicted, ".", markersize=1, label="predicted")
    left.set_xlabel(x)
    left.set_ylabel(y)
    left.legend()
    walls = study.fit.operator.walls
    shown = walls[:-1] if walls[-1] - walls[-2] > 3 * np.median(np.diff(walls)) else walls
    cells = study.fit.operator.density[: shown.size - 1, : shown.size - 1].copy()
    cells[np.triu_indices_from(cells, 1)] = np.nan
    off_diagonal = cells[np.tril_indices_from(cells, -1)]
    top = max(float(np.quantile(off_diagonal, 0.999)), np.finfo(float).tiny)
    signed = not study.fit.nonnegative
    image = right.pcolormesh(
        shown,
        shown,
        cells,
        vmin=-top if signed else 0.0,
        vmax=top,
        cmap="RdBu_r" if signed else None,
        rasterized=True,
    )
    right.set_xlabel(f"beta: {x}")
    right.set_ylabel(f"alpha: {x}")
    figure.colorbar(image, ax=right, label="density (diagonal clipped)")
    figure.savefig(folder / f"{name}.png", dpi=120)


def _print_range(curves: ReversalCurves, plots: Path | None) -> None:
    print("magnetic, whole recording, every other curve held out; RMSE [1e-6 A m^2]")
    print(
        f"{'level':>5} {'cells':>6} {'samples':>8} {'nnls':>8} {'(fitted)':>8} {'slope':>7} {'slackness':>9} {'smooth >= 0':>11} "
        f"{'rough':>8} {'smooth':>8} {'% of range':>10} {'gain':>6} {'strength':>8} {'trained on':>10}",
        flush=True,
    )
    for level, first in [*((level, 1) for level in LEVELS), (LEVELS[-2], 0)]:
        study = magnetic_range_study(curves, level, first=first)
        share = 100 * study.smooth_rmse / np.ptp(study.output)
        print(
            f"{level:5d} {level * (level + 1) // 2:6d} {study.output.size:8d} {study.plain_rmse:8.4f} "
            f"{study.plain_training:8.4f} {study.slope:7.0e} {study.slackness:9.0e} "
            f"{study.nonnegative_rmse:11.4f} {study.rough_rmse:8.4f} {study.smooth_rmse:8.4f} "
            f"{share:10.4f} {study.gain:6.1%} {study.fit.strength:8.0e} {'odd' if first else 'even':>10}",
            flush=True,
        )
        if plots is not None and first:
            plots.mkdir(parents=True, exist_ok=True)
            _plot(plots, f"magnetic_level_{level}", study, "field [T]", "moment [1e-6 A m^2]")
    print()


def main(arguments: Sequence[str] | None = None) -> int:
    """Print held-out errors of Preisach fits to the measured recordings."""
    parser = argparse.ArgumentParser(
        prog="python -m vo2_studies.preisach.measured_study", description=main.__doc__
    )
    parser.add_argument(
        "--data", type=Path, default=None, help="folder with magnetic_forc, piezo and vo2_device"
    )
    parser.add_argument("--plots", type=Path, default=None, help="folder to write labelled plots to")
    chosen = parser.parse_args(arguments)
    folder = chosen.data or data_folder()
    if folder is None or not folder.is_dir():
        parser.error(f"--data: found {folder}, need the folder of measured recordings (or set VO2_DATA)")
    studies: list[tuple[str, str, HeldOut, str, str]] = []
    curves = read_reversal_curves(folder / "magnetic_forc" / "UB199BF")
    _print_range(curves, chosen.plots)
    for number, window in enumerate(WINDOWS_T, 1):
        title = f"magnetic, {1e3 * window[0]:.0f} to {1e3 * window[1]:.0f} mT"
        study = magnetic_study(curves, window)
        studies.append((title, f"magnetic_{number}", study, "field [T]", "moment [1e-6 A m^2]"))
    voltage, displacement = read_piezo(folder / "piezo" / "Model_Vi_Do.dat")
    studies.append(
        ("piezo, last 40 %", "piezo", piezo_study(voltage, displacement), "voltage [V]", "displacement [um]")
    )
    voltage, _, resistance = read_voltage_sweep(folder / "vo2_device" / "VO2_data_RvsV_transition.csv")
    studies.append(
        (
            "VO2 film, odd samples",
            "vo2_film",
            sweep_study(voltage, resistance),
            "voltage [V]",
            "-log10(R / ohm)",
        )
    )
    print(
        f"{'held out':28} {'level':>5} {'samples':>8} {'smooth RMSE':>12} {'% of range':>11} {'plain RMSE':>11} "
        f"{'gain':>7} {'strength':>9}"
    )
    for title, name, study, x, y in studies:
        print(
            f"{title:28} {study.fit.operator.level:5d} {study.output.size:8d} {study.smooth_rmse:12.4g} "
            f"{100 * study.smooth_rmse / study.output_range:11.3f} {study.plain_rmse:11.4g} {study.gain:7.1%} "
            f"{study.fit.strength:9.0e}"
        )
        if chosen.plots is not None:
            chosen.plots.mkdir(parents=True, exist_ok=True)
            _plot(chosen.plots, name, study, x, y)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
