"""Prandtl and Ishlinskii's plays on a device without body, with the lags that they tell.

Where such plays describe a loop to its noise, they tell a lag of the drive from one of the sensor, and either to a per cent,
which a law that is less exact cannot. So both are sought again with them, and kept where they predict held-out parts better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from vo2_models.device.description import DeviceDescription
from vo2_models.hysteresis.laws.bounded_plays import FORMS, BoundedFit, fit_bounded_plays
from vo2_models.identification.bank_fit import Late
from vo2_models.identification.grid import GriddedRecording
from vo2_models.identification.loop_law import LoopLaw, held_out_residual, root_mean_square
from vo2_models.identification.rig_dynamics import DAMPED, FASTEST, RigDynamics, loop_path, ringing, sensing

__all__ = ["behind_all", "bounded_loop", "dynamics_of_plays"]

Floats = NDArray[np.float64]
_BETTER = 0.9
"""Share of the held-out error of what is simpler, or was found before, below which a lag behind or other dynamics are taken."""
_HOPELESS = 6.0
"""Share of the held-out error of what was found before, above which no lag is sought."""
_LAGS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Lags tried first, of the sensor and every other one of the drive, in sample periods."""
_COMMON = ((1.0, 3),)
"""Exponent and degree with which these are tried."""
_SHORTEST, _SPREAD, _STEPS = 0.1, 0.3, 50
"""Shortest lag in sample periods, first step of a logarithm, and evaluations of the search for each unknown."""


def dynamics_of_plays(
    grids: Sequence[GriddedRecording],
    device: DeviceDescription,
    values: Floats,
    fold: NDArray[np.int64],
    found: RigDynamics,
    misfit: float,
) -> RigDynamics | None:
    """Return the dynamics that go with bounded plays, or None where other laws predict held-out parts as well or better.

    Parameters
    ----------
    grids : recordings in roles
    device : completed description
    values : (n,) response along `loop_path`, NaN where missing
    fold : (n,) part that each sample is held out with, -1 for none
    found : dynamics found with other laws
    misfit : held-out error of the law found with them
    """
    good, dt = np.isfinite(values), grids[0].dt
    longest = 0.1 * dt * max(grid.current.size for grid in grids)

    def fitted(dynamics: RigDynamics, forms: Sequence[tuple[float, int]] = FORMS) -> BoundedFit:
        return _fit(
            loop_path(grids, device, dynamics), values, fold, good, behind_all(grids, dynamics), forms
        )

    bounds = {
        "lag": (_SHORTEST * dt, longest),
        "behind": (_SHORTEST * dt, longest),
        "frequency": (1.0 / longest, 1.0 / (FASTEST * dt)),
        "damping": DAMPED,
    }

    def sought(
        start: RigDynamics, names: Sequence[str], form: tuple[float, int]
    ) -> tuple[float, RigDynamics]:
        least, most = np.array([bounds[name] for name in names]).T

        def of(vector: Floats) -> RigDynamics:
            numbers = np.clip(np.exp(vector), least, most).tolist()
            return replace(start, **dict(zip(names, numbers, strict=True)))

        first = np.log(np.maximum([getattr(start, name) for name in names], least))
        best = minimize(
            lambda vector: fitted(of(vector), (form,)).error, first, method="Nelder-Mead",
            options={
                "maxfev": _STEPS * first.size, "xatol": 1e-3, "fatol": 0.0,
                "initial_simplex": np.vstack([first, first + _SPREAD * np.eye(first.size)]),
            },
        )  # fmt: skip
        return float(best.fun), of(best.x)

    # what relaxes behind plays on a grid may be a sensor's lag, and its drive may have none or one of a sample
    plain = replace(found, relaxation=0.0, slow_share=0.0, slow=0.0, near=())
    front = [(fitted(one), one) for one in (plain, replace(plain, delay=dt))]
    lags = [k * dt for k in _LAGS if k * dt < longest]
    behind = [
        (fitted(one, _COMMON), one)
        for delay in ((0.0, dt) if not found.frequency else ())
        for lag in (0.0, *lags[::2])
        for one in (replace(plain, delay=delay, lag=lag, behind=lag_behind) for lag_behind in lags)
    ]
    if min(fit.error for fit, _ in (*front, *behind)) > _HOPELESS * misfit:
        return None
    fit, start = min(front, key=lambda one: one[0].error)
    error, dynamics = fit.error, start
    free = ("lag", "frequency", "damping") if found.frequency else ("lag",) if start.lag else ()
    if free:
        error, dynamics = min((error, start), sought(start, free, fit.form), key=lambda one: one[0])
    if behind:
        start = min(behind, key=lambda one: one[0].error)[1]
        form = fitted(start).form
        first = sought(start, ("lag", "behind"), form)
        # loops are narrow: the two lags in the other order are nearly as good, and a search does not come from there
        turned = replace(first[1], lag=first[1].behind, behind=first[1].lag)
        other = min(first, sought(turned, ("lag", "behind"), form), key=lambda one: one[0])
        held = replace(other[1], held=True)
        if fitted(held, (form,)).error < other[0]:
            other = min(other, sought(held, ("lag", "behind"), form), key=lambda one: one[0])
        if other[0] < _BETTER * error:
            error, dynamics = other
    own = bounded_loop(loop_path(grids, device, dynamics), values, fold, behind_all(grids, dynamics))
    return dynamics if own.misfit < _BETTER * misfit else None


def behind_all(grids: Sequence[GriddedRecording], dynamics: RigDynamics) -> Late | None:
    """Return what all of a response goes through behind its loops: a sensor that lags, or a mode; None where there is neither.

    Parameters
    ----------
    grids : recordings in roles
    dynamics : with a lag behind the loops, a frequency, or none
    """
    return sensing(grids, dynamics) or ringing(grids, dynamics)


def bounded_loop(path: Floats, values: Floats, fold: NDArray[np.int64], late: Late | None) -> LoopLaw:
    """Return bounded plays; the misfit is that of fits without each part.

    Parameters
    ----------
    path : (n,) loop coordinate, from lower saturation on
    values : (n,) measured, NaN where missing
    fold : (n,) part that each sample is held out with, -1 for none
    late : what all of the response goes through behind the law
    """
    good = np.isfinite(values)

    def left(measured: NDArray[np.bool_]) -> tuple[BoundedFit, Floats]:
        fit = _fit(path, values, fold, measured, late, FORMS)
        output = fit.law.run(_inside(path, good))
        return fit, values - (late.through(output[:, None])[:, 0] if late else output)

    held_out = held_out_residual(lambda measured: left(measured)[1], good, fold)
    fit, residual = left(good)
    words = f"law {fit.law.name} of {np.size(fit.law.radii)} plays"
    return LoopLaw(fit.law, root_mean_square(held_out), residual, words, held_out=held_out)


def _fit(
    path: Floats,
    values: Floats,
    fold: NDArray[np.int64],
    measured: NDArray[np.bool_],
    late: Late | None,
    forms: Sequence[tuple[float, int]],
) -> BoundedFit:
    good = np.isfinite(values)
    return fit_bounded_plays(
        _inside(path, good), np.where(good, values, 0.0), fold, measured,
        through=late.through if late else None, forms=forms,
    )  # fmt: skip


def _inside(path: Floats, good: NDArray[np.bool_]) -> Floats:
    """The path, whose rest before each recording is at its lower end."""
    return np.maximum(path, path[good].min())
