"""A hysteresis law for a quasi-static recording: fits of every law, and the choice between them on held-out excursions.

`fit_law` fits one law by name, `rank_laws` several. A law is judged on whole excursions of the input (from turn to turn
and on to the next) whose outputs the fit has not seen, while their inputs went through its memory. What is returned is
then fitted to everything.

Bouc-Wen, the limiting loop and the domains have few constants in which the output is not linear. Amplitude and
memoryless part are eliminated (variable projection), the rest is left to `scipy.optimize.least_squares` from several
starts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.special import ndtri
from scipy.stats import qmc

from vo2_models.hysteresis.bouc_wen import BoucWen
from vo2_models.hysteresis.domains import DomainEnsemble
from vo2_models.hysteresis.fitting_gpi import fit_play_model
from vo2_models.hysteresis.law import Law, Saturation
from vo2_models.hysteresis.laws import FITS
from vo2_models.hysteresis.limiting_loop import GAMMA, LimitingLoop
from vo2_models.hysteresis.preisach.smooth_fit import STRENGTHS, fit_smooth
from vo2_models.hysteresis.preisach.sparse_fit import choose_sparse
from vo2_models.validation import finite_array

__all__ = ["FITTED", "OF_PLAYS", "PLAYS", "LawFit", "excursions", "fit_law", "rank_laws"]

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

TURN = 0.02
"""Share of the input's range that a turn must be followed by to begin an excursion; below it is noise."""
HELD_OUT = 3
"""Every how many excursions one is held out."""
LEVELS = (16, 40)
"""Levels of the Preisach grids that are tried."""
FINE_LEVEL, FINE_FROM = 60, 3000
"""A finer level, and the number of samples from which it is tried as well."""
PLAYS = 12
"""Plays of the laws that have them."""
DOMAINS = 1000


@dataclass(frozen=True, eq=False)
class LawFit:
    """A fitted law and its error on excursions it had not seen.

    Attributes
    ----------
    name : as `fit_law` takes it
    law : fitted to all samples
    memory : (law.memory_size,) before the first sample
    rmse : root mean square of output minus model over all samples [output unit]
    held_out_rmse : the same over the held-out excursions, of a fit without them; NaN where there were none to hold out
    """

    name: str
    law: Law
    memory: Floats
    rmse: float
    held_out_rmse: float

    def predict(self, u: ArrayLike) -> Floats:
        """Return the outputs (n,) along the inputs u (n,), from where the recording started."""
        return self.law.run(u, self.memory.copy())


def excursions(u: ArrayLike) -> NDArray[np.int64]:
    """Return the excursion (n,) that each sample of the input u (n,) belongs to: from a turn over the next to its end.

    Parameters
    ----------
    u : (n,) inputs

    Examples
    --------
    >>> excursions([0.0, 1.0, 2.0, 1.0, 0.0, 1.0, 1.5, 1.0, 0.0]).tolist()
    [0, 0, 0, 0, 0, 1, 1, 1, 1]
    """
    inputs = finite_array(u, "u")
    least = TURN * float(np.ptp(inputs))
    legs = np.zeros(inputs.size, dtype=np.int64)
    extreme, turn, rises, leg = inputs[0], 0, 0, 0
    for k, v in enumerate(inputs):
        if rises == 0 and abs(v - inputs[0]) > least:
            rises, extreme, turn = (1 if v > inputs[0] else -1), v, k
        elif rises and (v - extreme) * rises >= 0:
            extreme, turn = v, k
        elif rises and (extreme - v) * rises > least:
            leg += 1
            legs[turn + 1 : k] = leg
            rises, extreme, turn = -rises, v, k
        legs[k] = leg
    return legs // 2


def fit_law(
    name: str,
    u: ArrayLike,
    y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
) -> LawFit:
    """Fit one law to a quasi-static recording.

    Parameters
    ----------
    name : of `FITTED`
    u, y : (n,) input and output, in any units, the output rising with the input through the loop (-log10 R)
    groups : (n,) number of the excursion or curve of each sample; by default found by `excursions`

    Returns
    -------
    LawFit : the law, and how well it predicts what was held out

    Raises
    ------
    ValueError : another name, not finite, constant, shapes that differ, or too few samples for this law.
    """
    if name not in FITTED:
        raise ValueError(f"law: found {name!r}, need one of {', '.join(FITTED)}")
    inputs, outputs, label = _record(u, y, groups)
    measured = label % HELD_OUT != HELD_OUT - 1
    held_out = np.nan
    if not measured.all():
        law, memory = FITTED[name](inputs, outputs, label, measured)
        held_out = _rms((outputs - law.run(inputs, memory.copy()))[~measured])
    law, memory = FITTED[name](inputs, outputs, label, np.ones(inputs.size, dtype=np.bool_))
    return LawFit(name, law, memory, _rms(outputs - law.run(inputs, memory.copy())), held_out)


def rank_laws(
    u: ArrayLike, y: ArrayLike, *, laws: Sequence[str] = (), groups: ArrayLike | None = None
) -> tuple[LawFit, ...]:
    """Fit several laws and return them by their held-out errors, the best first.

    A law that needs more samples than there are is left out. Without an excursion to hold out (a single loop) the errors on
    the samples themselves decide, which favours laws with many constants: `LawFit.held_out_rmse` is then NaN.

    Parameters
    ----------
    laws : names, all of `FITTED` by default
    u, y, groups : as `fit_law`

    Raises
    ------
    ValueError : as `fit_law`; or no law can be fitted.
    """
    inputs, outputs, label = _record(u, y, groups)
    found, refused = [], []
    for name in laws or tuple(FITTED):
        try:
            found.append(fit_law(name, inputs, outputs, groups=label))
        except ValueError as error:
            refused.append(f"{name}: {error}")
    if not found:
        raise ValueError("; ".join(refused))
    return tuple(
        sorted(found, key=lambda fit: fit.rmse if np.isnan(fit.held_out_rmse) else fit.held_out_rmse)
    )


def _record(u: ArrayLike, y: ArrayLike, groups: ArrayLike | None) -> tuple[Floats, Floats, NDArray[np.int64]]:
    inputs = finite_array(u, "u")
    outputs = finite_array(y, "y", size=inputs.size)
    for name, array in (("u", inputs), ("y", outputs)):
        if array.size < 3 or np.ptp(array) <= 0:
            raise ValueError(f"{name}: found {array.size} samples that do not vary, need a signal that does")
    label = excursions(inputs) if groups is None else np.asarray(groups, dtype=np.int64)
    if label.shape != inputs.shape:
        raise ValueError(f"groups: found shape {label.shape}, need {inputs.shape}")
    return inputs, outputs, np.unique(label, return_inverse=True)[1]


def _rms(residual: Floats) -> float:
    return float(np.sqrt(np.mean(residual**2)))


def _preisach(u: Floats, y: Floats, label: NDArray[np.int64], measured: Booleans) -> tuple[Law, Floats]:
    """Smooth densities on the level, with the strength and sign, that predict parts left out best."""
    label = label if np.unique(label[measured]).size >= 5 else np.arange(u.size) * 50 // u.size
    levels = (*LEVELS, FINE_LEVEL) if u.size >= FINE_FROM else LEVELS
    fits = [
        fit_smooth(
            u,
            y,
            np.linspace(u.min(), u.max(), level + 1),
            nonnegative=None,
            groups=label,
            measured=measured,
            strengths=STRENGTHS,
        )
        for level in levels
    ]
    best = min(fits, key=lambda fit: float(fit.held_out_rmse.min()))
    return best.operator, best.operator.initial_memory()


def _sparse(u: Floats, y: Floats, label: NDArray[np.int64], measured: Booleans) -> tuple[Law, Floats]:
    """Compressive sensing: the Preisach density that is sparsest in the basis that predicts parts left out best."""
    label = label if np.unique(label[measured]).size >= 5 else np.arange(u.size) * 50 // u.size
    law = choose_sparse(u, y, label, measured).operator
    return law, law.initial_memory()


def _filed(
    law_of: Callable[..., Law],
) -> Callable[[Floats, Floats, NDArray[np.int64], Booleans], tuple[Law, Floats]]:
    """Return the fit of a law that its own file gives."""

    def fit(u: Floats, y: Floats, label: NDArray[np.int64], measured: Booleans) -> tuple[Law, Floats]:
        law = law_of(u, y, label, measured)
        return law, law.initial_memory()

    return fit


def _plays(
    memoryless: str, plays: int = PLAYS
) -> Callable[[Floats, Floats, NDArray[np.int64], Booleans], tuple[Law, Floats]]:
    def fit(u: Floats, y: Floats, label: NDArray[np.int64], measured: Booleans) -> tuple[Law, Floats]:
        found = fit_play_model(u, y, plays=plays, memoryless=memoryless, measured=measured)
        return found.model.bank(), found.model.initial_state(found.initial)

    return fit


@dataclass(frozen=True)
class _Shape:
    """A law of unit amplitude by its constants, with starts and bounds, all for inputs from -1 to 1."""

    law: Callable[..., Law]
    starts: tuple[tuple[float, ...], ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]


def _limiting_loop(slope: float, ratio: float, centre: float, width: float, gamma: float) -> LimitingLoop:
    half = 0.5 * np.exp(width)
    return LimitingLoop(np.exp(slope), centre + half, np.exp(slope + ratio), centre - half, gamma, -1.0, 1.0)


# evenly spread normal numbers for the domains' thresholds and widths, the same at every call
_NORMAL = ndtri(qmc.Halton(2, scramble=False).random(DOMAINS + 1)[1:])
_NARROWEST = 1e-3


def _domains(centre: float, spread: float, width: float, scatter: float, coupling: float) -> DomainEnsemble:
    middle = centre + np.exp(spread) * _NORMAL[:, 0]
    half = 0.5 * np.exp(width + np.exp(scatter) * _NORMAL[:, 1]) + _NARROWEST
    return DomainEnsemble(middle + half, middle - half, None, coupling, -1.0, 1.0)


_SHAPES: Mapping[str, _Shape] = {
    "bouc_wen": _Shape(
        lambda rho, excess, n: BoucWen(np.exp(rho), 0.5 + np.exp(excess), n),
        ((1.0, -1.0, 1.0), (2.0, -1.0, 1.5), (0.0, 0.0, 1.0), (2.5, 0.5, 2.0)),
        (-3.0, -9.0, 1.0),
        (5.0, 3.0, 6.0),
    ),
    "limiting_loop": _Shape(
        _limiting_loop,
        tuple((s, 0.0, c, w, GAMMA) for s in (0.7, 1.6) for c in (-0.2, 0.2) for w in (-1.5, -0.5)),
        (-3.0, -2.0, -1.5, -7.0, 0.0),
        (5.0, 2.0, 1.5, 1.0, 1.0),
    ),
    "domains": _Shape(
        _domains,
        tuple((c, s, w, -0.7, 0.0) for c in (-0.2, 0.2) for s in (-1.5, -0.7) for w in (-1.5, -0.5)),
        (-1.5, -6.0, -7.0, -4.0, -2.0),
        (1.5, 1.0, 1.0, 1.0, 2.0),
    ),
}
_STEP = 0.01
"""Step of the derivatives: wide, as a finite number of domains makes the output a staircase."""
_TRIAL, _FINISHED, _EVALUATIONS = 8, 2, 60
"""Evaluations of each start, how many starts are run on, and for how many evaluations."""


def _projected(
    shape: _Shape,
) -> Callable[[Floats, Floats, NDArray[np.int64], Booleans], tuple[Law, Floats]]:
    """Return the fit of a law with few constants; amplitude, bias and linear part come by linear least squares."""

    def fit(u: Floats, y: Floats, label: NDArray[np.int64], measured: Booleans) -> tuple[Law, Floats]:
        centre, half = float(u.max() + u.min()) / 2, float(np.ptp(u)) / 2
        z = (u - centre) / half
        line = np.column_stack([np.ones(z.size), z])
        scale = float(np.ptp(y))

        def linear(theta: Floats, side: Saturation) -> tuple[Floats, Floats]:
            """Residual over the range, and amplitude, bias and slope."""
            columns = np.column_stack([_unit(shape.law(*theta), z, side), line])
            found = np.linalg.lstsq(columns[measured], y[measured], rcond=None)[0]
            return (columns @ found - y)[measured] / scale, found

        def run(theta: Floats, side: Saturation, evaluations: int) -> tuple[float, Floats, Saturation]:
            def residual(at: Floats) -> Floats:
                return linear(at, side)[0]

            def jacobian(at: Floats) -> Floats:
                here = residual(at)
                steps = np.where(at + _STEP <= shape.upper, _STEP, -_STEP)
                moved = [(residual(at + step) - here) / step.sum() for step in np.diag(steps)]
                return np.stack(moved, axis=1)

            found = least_squares(
                residual, theta, jacobian, bounds=(shape.lower, shape.upper), max_nfev=evaluations
            )
            return float(found.cost), found.x, side

        sides: tuple[Saturation, ...] = ("lower", "upper")
        runs = [run(np.array(start), side, _TRIAL) for start in shape.starts for side in sides]
        runs = sorted(runs, key=lambda trial: trial[0])[:_FINISHED]
        _, theta, side = min((run(x, side, _EVALUATIONS) for _, x, side in runs), key=lambda trial: trial[0])
        amplitude, bias, slope = linear(theta, side)[1]
        law = _scaled(
            shape.law(*theta), centre, half, amplitude, (bias - slope * centre / half, slope / half)
        )
        return law, _before(law, float(u[0]), side)

    return fit


def _unit(law: Law, z: Floats, side: Saturation) -> Floats:
    return law.run(z, _before(law, float(z[0]), side))


def _before(law: Law, first: float, side: Saturation) -> Floats:
    """Memory on the major branch that leads from saturation to the first input."""
    return law.settle(first, side)


def _scaled(law: Any, centre: float, half: float, amplitude: float, polynomial: tuple[float, float]) -> Law:
    """Return the law of unit amplitude over inputs from -1 to 1 in the units of the recording."""
    if isinstance(law, BoucWen):
        return replace(law, rho=law.rho / half, amplitude=amplitude, polynomial=polynomial)
    ends: dict[str, Any] = {"lower": -amplitude, "upper": amplitude, "polynomial": polynomial}
    if isinstance(law, LimitingLoop):
        slopes: dict[str, Any] = {
            name: getattr(law, name) / half for name in ("rising_slope", "falling_slope")
        }
        centres: dict[str, Any] = {
            name: centre + half * getattr(law, name) for name in ("rising_centre", "falling_centre")
        }
        return replace(law, **slopes, **centres, **ends)
    return replace(
        law,
        alpha=centre + half * law.alpha,
        beta=centre + half * law.beta,
        coupling=half * law.coupling,
        **ends,
    )


OF_PLAYS: Mapping[
    str, Callable[[int], Callable[[Floats, Floats, NDArray[np.int64], Booleans], tuple[Law, Floats]]]
] = {"gpi": partial(_plays, "none"), "egpi": partial(_plays, "cubic")}
"""Name -> fit, as in `FITTED`, of the law with a number of plays."""
FITTED: Mapping[str, Callable[[Floats, Floats, NDArray[np.int64], Booleans], tuple[Law, Floats]]] = {
    "preisach": _preisach,
    "cs": _sparse,
    **{name: fit(PLAYS) for name, fit in OF_PLAYS.items()},
    **{name: _projected(shape) for name, shape in _SHAPES.items()},
    **{name: _filed(law_of) for name, law_of in FITS.items()},
}
"""Name -> fit of the law to the samples that are measured: (u, y, excursions, measured) -> law, memory before them."""
