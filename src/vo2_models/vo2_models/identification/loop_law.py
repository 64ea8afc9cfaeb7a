"""The law of a loop over its coordinate: fitted by name, or chosen by what predicts held-out parts of the calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.law_fit import FITTED, OF_PLAYS
from vo2_models.hysteresis.law_fit import PLAYS as COUNT
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.hysteresis.preisach.sparse_fit import choose_sparse
from vo2_models.identification.bank_fit import BankShape, fit_bank
from vo2_models.identification.device_fit import FitResult
from vo2_models.identification.loops_fit import SECTIONS
from vo2_models.identification.play_dictionary import FOLDS, fold_of
from vo2_models.identification.preisach_choice import choose_preisach

__all__ = [
    "AUTO",
    "FEWEST_RECORDINGS",
    "LAW_CHOICES",
    "PLAYS",
    "LoopLaw",
    "better_of",
    "curves_of_fan",
    "fit_loop_law",
    "folds_of_recordings",
    "held_out_residual",
    "root_mean_square",
    "with_law",
]

Floats = NDArray[np.float64]
AUTO, PLAYS = "auto", "plays"
LAW_CHOICES = (PLAYS, *FITTED, AUTO)
"""What `fit --law` takes."""
FEWEST_RECORDINGS = 3
"""Recordings from which whole ones are held out instead of blocks of time."""
_STEPS = 40
_AT_END = 0.05
"""Share of the range that counts as its end, from which the curves of a fan begin."""
MARGIN = 0.97
"""Share of the held-out error of what is simpler, below which something less simple is taken."""


@dataclass(frozen=True)
class LoopLaw:
    """A fitted law.

    Attributes
    ----------
    law : of the registry
    misfit : root mean square of the residual on held-out parts; NaN where nothing could be held out
    residual : (n,) measured minus law, NaN where there is no value
    words : what it is made of
    uncertainty : name of an array of the law -> standard deviations
    held_out : (n,) as `residual`, of fits without each part, NaN where no part was held out; None where they are not kept
    """

    law: Law
    misfit: float
    residual: Floats = field(repr=False)
    words: str
    uncertainty: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    held_out: Floats | None = field(default=None, repr=False)


def folds_of_recordings(drives: Sequence[Floats], fold: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the parts to hold out: whole recordings, where there are at least three, else blocks of time, of a fan its curves.

    With recordings of different amplitude the question is what lies between them, which blocks of time do not ask. A
    recording that reaches beyond all others is never held out: that would be an extrapolation. So is a block of neighbouring
    reversal curves: of these each is held out with others that are far from it.

    Parameters
    ----------
    drives : (m,) drive of each recording
    fold : (n,) blocks of time along all recordings, one sample before each; -1 where there is no value

    Returns
    -------
    (n,) part of each sample, -1 for those that are always given
    """
    if len(drives) < FEWEST_RECORDINGS:
        return _curves_in_turn(drives, fold)
    whole = np.full(fold.size, -1, dtype=np.int64)
    ends, count = np.cumsum([0, *(drive.size + 1 for drive in drives)]), 0
    for k, drive in enumerate(drives):
        others = [one for j, one in enumerate(drives) if j != k]
        inside = min(o.min() for o in others) <= drive.min() + 0.01 * np.ptp(drive)
        if inside and drive.max() <= max(o.max() for o in others):
            whole[ends[k] : ends[k + 1]] = count
            count += 1
    whole[fold < 0] = -1
    return whole if (whole >= 0).any() else fold


def _curves_in_turn(drives: Sequence[Floats], fold: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same parts (n,), where a recording is a fan of reversal curves by the curve."""
    parts, begin = fold.copy(), 0
    for drive in drives:
        where = slice(begin + 1, begin + 1 + drive.size)  # one sample before each recording
        begin = where.stop
        curve, good = curves_of_fan(drive), fold[where] >= 0
        _, number = np.unique(curve[good], return_inverse=True)
        if number.max(initial=0) >= 2 * FOLDS:
            parts[where][good] = number % FOLDS
    return parts


def curves_of_fan(drive: Floats) -> NDArray[np.int64]:
    """Return the number of the reversal curve of each sample of a drive (n,); zeros where it is no fan of such curves.

    A fan begins each curve at one end of the range, and reverses further or less far from it than the curve before.

    Parameters
    ----------
    drive : in any unit
    """
    span = float(np.ptp(drive))
    for rising in (drive, -drive):
        at_end = rising > rising.max() - _AT_END * span
        curve = np.cumsum(at_end & ~np.concatenate([[False], at_end[:-1]]))
        turns = np.array([rising[curve == k].min() for k in range(1, int(curve.max(initial=0)) + 1)])[1:-1]
        steps = np.diff(turns)
        if (
            turns.size > 2 * FOLDS
            and np.ptp(turns) > _AT_END * span
            and (np.all(steps < 0) or np.all(steps > 0))
        ):
            return curve
    return np.zeros(drive.size, dtype=np.int64)


def fit_loop_law(
    name: str, path: Floats, values: Floats, fold: NDArray[np.int64], plays: int = COUNT
) -> LoopLaw:
    """Fit one law of `FITTED`; its misfit is that of fits without each part.

    Parameters
    ----------
    name : of `FITTED`
    path : (n,) loop coordinate, from lower saturation on
    values : (n,) measured, NaN where missing
    fold : (n,) part that each sample is held out with, -1 for none
    plays : of a law of `OF_PLAYS`

    Returns
    -------
    LoopLaw : the law, with its misfit in the unit of `values`

    Raises
    ------
    ValueError : another name, or what the fit of the law refuses.
    """
    if name not in FITTED:
        raise ValueError(f"law: found {name!r}, need one of {', '.join(LAW_CHOICES)}")
    good = np.isfinite(values)
    if name == "preisach":
        found = choose_preisach(path, values, fold)
        return LoopLaw(found.law, found.misfit, found.residual, found.words, held_out=found.held_out)
    inside = np.maximum(path, path[good].min())  # what comes before a recording lies far below
    filled = np.where(good, values, 0.0)
    if name == "cs":
        sparse = choose_sparse(inside, filled, fold, good)
        told = ", ".join(f"{basis} {error:.3g}" for basis, error in sparse.held_out_rmse.items())
        words = f"Preisach law of {sparse.operator.level} levels, sparse in basis {sparse.basis} (held out: {told})"
        left = np.where(good, values - sparse.operator.run(inside), np.nan)
        return LoopLaw(sparse.operator, sparse.error, left, words)
    fit = OF_PLAYS[name](plays) if name in OF_PLAYS else FITTED[name]

    def residual(measured: NDArray[np.bool_]) -> tuple[Law, Floats]:
        law, _ = fit(inside, filled, fold, measured)
        return law, np.where(good, values - law.run(inside), np.nan)

    held_out = held_out_residual(lambda measured: residual(measured)[1], good, fold)
    law, left = residual(good)
    return LoopLaw(law, root_mean_square(held_out), left, f"law {name}", held_out=held_out)


def held_out_residual(
    residual: Callable[[NDArray[np.bool_]], Floats], good: NDArray[np.bool_], fold: NDArray[np.int64]
) -> Floats:
    """Return the residual (n,) of each part of a fit without it, NaN where nothing was held out.

    Parameters
    ----------
    residual : of a fit to some samples (n,)
    good : (n,) samples that hold a value
    fold : (n,) part that each sample is held out with, -1 for none
    """
    out = np.full(good.size, np.nan)
    for part in np.unique(fold[good & (fold >= 0)]):
        held = good & (fold == part)
        out[held] = residual(good & ~held)[held]
    return out


def root_mean_square(values: Floats) -> float:
    """Return that of the values (n,) that are there; NaN where none is."""
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if there.size else float("nan")


def with_law(result: FitResult, name: str, plays: int = COUNT) -> FitResult:
    """Return a fit in which the laws of the loops are others, over the same temperatures.

    Lags, temperature scale and noise stay those that were found with plays. For `AUTO`, plays stay where no other law
    predicts held-out parts better; their own held-out error is that of twelve plays fitted anew without each part.

    Parameters
    ----------
    result : with banks of plays
    name : of `FITTED`, or `AUTO`
    plays : of a law of `OF_PLAYS`

    Raises
    ------
    ValueError : as `fit_loop_law`.
    """
    laws: dict[str, Any] = {}
    residuals, sensors = dict(result.residuals), dict(result.model.sensors)
    channels = result.model.description.names
    uncertainty, notes = dict(result.model.uncertainty), list(result.notes)
    for role, section in SECTIONS.items():
        law = getattr(result.model, section)
        if role not in result.residuals or not law.present:
            continue
        output = law.run(result.path, law.initial_memory())
        values = output + result.residuals[role]
        fold = fold_of(np.isfinite(values))
        names = tuple(FITTED) if name == AUTO else (name,)
        found = min(
            (fit_loop_law(one, result.path, values, fold, plays) for one in names), key=lambda one: one.misfit
        )
        if name == AUTO:
            own = _plays_again(law, result.path, values, fold)
            if not found.misfit < MARGIN * own:
                notes.append(
                    f"{channels[role]}: plays, held-out error {own:.3g}; best of the other laws {found.misfit:.3g}"
                )
                continue
        laws[section], residuals[role] = found.law, found.residual
        notes.append(f"{channels[role]}: {found.words}, held-out error {found.misfit:.3g}")
        sensors[role] = replace(
            sensors[role], residual=float(np.sqrt(np.nanmean(found.residual**2))), misfit=found.misfit
        )
        uncertainty = {key: std for key, std in uncertainty.items() if not key.startswith(f"{section}.")}
    model = replace(result.model, **laws, sensors=sensors, uncertainty=uncertainty)
    return replace(result, model=model, residuals=residuals, notes=tuple(notes))


def _plays_again(law: Law, path: Floats, values: Floats, fold: NDArray[np.int64]) -> float:
    """Error of a bank of plays on the parts it was not given, fitted from where the bank stands."""
    start, gaps = BankShape.of_bank(cast("PlayBank", law)), []
    for part in np.unique(fold[fold >= 0]):
        moved = fit_bank(path, np.where(fold == part, np.nan, values), start, iterations=_STEPS)
        gaps.append(moved.residual_of(path, values)[fold == part])
    return float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)))


def better_of(simple: LoopLaw, others: Sequence[LoopLaw]) -> LoopLaw:
    """Return the law with the smallest misfit; another than the first must be better by a margin.

    Parameters
    ----------
    simple : preferred
    others : tried against it
    """
    best = min(others, key=lambda one: one.misfit, default=simple)
    return best if best.misfit < MARGIN * simple.misfit else simple
