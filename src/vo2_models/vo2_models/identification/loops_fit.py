"""Both loops of a device over one temperature path, with time constant and dead time where they are not yet known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.model import DeviceModel
from vo2_models.identification.bank_fit import (
    BankFit,
    BankShape,
    evaluate,
    fit_bank,
    shape_rules,
    starting_shape,
)
from vo2_models.identification.grid import GriddedRecording
from vo2_models.identification.levenberg_marquardt import levenberg_marquardt
from vo2_models.identification.noise import correlation_inflation
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = ["SECTIONS", "Loops", "film_path", "fit_loops"]

Floats = NDArray[np.float64]
COLD = -300.0
"""Temperature [degC] put between two recordings, which brings every play back to its cold saturation."""
STAIRCASE = 0.25
"""Recordings whose steps are all smaller than this share of the range do not pin down the time constant."""
_MOVES = 0.05
"""Distance of the film from its steady temperature, as a share of its range, that one sample in a hundred must have for a
recording to have transients."""
STAIRCASE_BIAS = 0.018
"""Relative error (one standard deviation) that the time constant then has beside its scatter: over the simulated
devices 1 to 8, calibrated with a damped oscillation of 20 levels, it was 1.7 % (at most 3.5 %); with 60 random levels
behind it, 0.1 % (at most 0.2 %)."""
SECTIONS = {RESISTANCE: "resistance", TIP_DEFLECTION: "deflection"}


@dataclass(frozen=True)
class Loops:
    """Both banks fitted over one temperature path.

    Attributes
    ----------
    scalars, std : scalar parameters of the model, and standard deviations of those that were fitted
    path : (n,) film temperature, as of `film_path` [degC]
    fits : channel -> fit of its bank
    settled : whether the recordings start settled at their first current
    notes : what the recordings did not allow
    """

    scalars: dict[str, float]
    std: dict[str, float]
    path: Floats
    fits: dict[str, BankFit]
    settled: bool
    notes: tuple[str, ...] = ()

    @property
    def cost(self) -> float:
        """Log-likelihood up to sign and constants, to compare starts on the same data."""
        return sum(float(np.log(np.nanmean(np.square(f.residual)))) for f in self.fits.values())


def film_path(model: DeviceModel, grids: Sequence[GriddedRecording], settled: bool) -> Floats:
    """Film temperature of all recordings one behind the other, each preceded by one cold sample.

    Parameters
    ----------
    model : its driver and thermal model
    grids : recordings
    settled : whether each starts settled at its first current

    Returns
    -------
    array : (n,) [degC]
    """
    parts = []
    for grid in grids:
        state = model.simulation.settled_state(grid.current[0], grid.dt) if settled else None
        out = model.simulation.run(grid.current, dt=grid.dt, state=state)
        parts += [np.array([COLD]), out[:, 5]]
    return np.concatenate(parts)


def _values(grids: Sequence[GriddedRecording], channel: str) -> Floats:
    """Measured values along the path of `film_path`."""
    parts = []
    for grid in grids:
        missing = np.full(grid.current.size, np.nan)
        parts += [np.array([np.nan]), grid.measured.get(channel, missing)]
    return np.concatenate(parts)


def fit_loops(
    model: DeviceModel,
    grids: Sequence[GriddedRecording],
    plays: int,
    *,
    settled: bool,
    thermal: bool,
    say: Callable[[str, float], None],
) -> Loops:
    """Fit the banks, and (where `thermal`) time constant and dead time along with them.

    Parameters
    ----------
    model : where driver and thermal model start, or stay
    grids : recordings
    plays : plays of each bank
    settled : whether the recordings start settled at their first current instead of from a cold rest
    thermal : whether time constant and dead time are to be found
    say : called with what is being done and the share done

    Returns
    -------
    Loops : scalar parameters, film path, and the fit of each bank
    """
    channels = [name for name in SECTIONS if any(name in grid.measured for grid in grids)]
    path = film_path(model, grids, settled)
    values = {name: _values(grids, name) for name in channels}
    fits = {}
    for k, name in enumerate(channels):
        say(f"loop of {name}", 0.1 + 0.25 * k)
        start = starting_shape(path, values[name], plays=plays)
        fits[name] = fit_bank(path, values[name], start)
    loops = Loops(dict(model.scalars), {}, path, fits, settled)
    if not thermal:
        return loops
    say("transients", 0.6)
    spread = _thermal_spread(model, grids, loops)
    tau = model.scalars["thermal.time_constant"]
    if spread["thermal.time_constant"] > 0.25 * tau:
        return replace(
            loops, notes=(_no_lag_note(model, grids, loops, spread["thermal.time_constant"] / tau),)
        )
    loops = _fit_together(model, grids, loops, values)
    std = _thermal_spread(replace(model, scalars=loops.scalars), grids, loops)
    jumps = _jumps(model, grids)
    if np.quantile(jumps, 0.995) > STAIRCASE:
        return replace(loops, std=std)
    tau = loops.scalars["thermal.time_constant"]
    std["thermal.time_constant"] = max(std["thermal.time_constant"], STAIRCASE_BIAS * tau)
    large = int(np.count_nonzero(jumps > STAIRCASE))
    wanted = int(np.ceil(0.005 * jumps.size))
    note = (
        f"{f'only {large} steps of the drive are' if large else 'no step of the drive is'} large, and small ones a slightly "
        f"wrong loop imitates: the time constant may be {100 * STAIRCASE_BIAS:.1f} % off; steps of more than "
        f"{100 * STAIRCASE:.0f} % of the range, {wanted} or more, such as random levels, would settle it"
    )
    return replace(loops, std=std, notes=(note,))


def _no_lag_note(model: DeviceModel, grids: Sequence[GriddedRecording], loops: Loops, spread: float) -> str:
    """Why time constant and dead time are the preset's: nothing shows them, or what the loops leave hides them."""
    targets = np.concatenate([np.r_[np.nan, target] for target in _steady(model, grids)])
    behind = np.abs(targets + model.scalars["thermal.ambient"] - loops.path)
    if np.nanquantile(behind, 0.99) < _MOVES * (np.nanmax(targets) - np.nanmin(targets)):
        return "no transients in the recording: time constant and dead time are the preset's"
    return (
        "the recording has transients, but what the loops leave over hides the lag (time constant +- "
        f"{100 * spread:.3g} %): time constant and dead time are the preset's"
    )


def _steady(model: DeviceModel, grids: Sequence[GriddedRecording]) -> list[Floats]:
    """Rise (n,) of the steady temperature by the drive of each recording [K]."""
    linear, square = model.scalars["thermal.linear_gain"], model.scalars["thermal.square_gain"]
    return [linear * grid.current + square * np.square(grid.current) for grid in grids]


def _jumps(model: DeviceModel, grids: Sequence[GriddedRecording]) -> Floats:
    """Steps (n,) of the steady temperature between neighbouring samples, as a share of its range."""
    targets = _steady(model, grids)
    jumps = np.concatenate([np.abs(np.diff(target)) for target in targets])
    return np.asarray(jumps / np.ptp(np.concatenate(targets)))


_THERMAL = ("thermal.time_constant", "driver.dead_time")


def _thermal_columns(
    model: DeviceModel, grids: Sequence[GriddedRecording], loops: Loops
) -> list[dict[str, Floats]]:
    """Derivative of each channel by the logarithm of the time constant and by the dead time in time constants."""
    tau = model.scalars["thermal.time_constant"]
    found = []
    for name, step in zip(_THERMAL, (0.01, 0.02), strict=True):
        moved = (
            model.scalars[name] * (1.0 + step) if name == _THERMAL[0] else model.scalars[name] + step * tau
        )
        other = film_path(replace(model, scalars={**model.scalars, name: moved}), grids, loops.settled)
        found.append(
            {
                channel: (evaluate(fit.shape, other)[0] - evaluate(fit.shape, loops.path)[0]) / step
                for channel, fit in loops.fits.items()
            }
        )
    return found


def _thermal_spread(model: DeviceModel, grids: Sequence[GriddedRecording], loops: Loops) -> dict[str, float]:
    """Standard deviations [s] of time constant and dead time with the banks free (their tangent projected out).

    Sandwich estimate over blocks of 50 samples, so that a residual which is correlated and larger on some branches
    counts as such. It knows the scatter, not the bias that a wrong loop shape may cause.
    """
    tau = model.scalars["thermal.time_constant"]
    columns = _thermal_columns(model, grids, loops)
    information = np.zeros((2, 2))
    scores = []
    for channel, fit in loops.fits.items():
        ok = np.isfinite(fit.residual)
        sigma = _effective_deviation(fit.residual)
        both = np.column_stack([column[channel][ok] for column in columns]) / sigma
        clean = _without_tangent(both, fit.jacobian[ok])
        information += clean.T @ clean
        score = clean * (fit.residual[ok] / sigma)[:, None]
        scores += [block.sum(axis=0) for block in np.array_split(score, max(len(score) // 50, 2))]
    inverse = np.linalg.pinv(information)
    meat = np.einsum("bi,bj->ij", np.array(scores), np.array(scores))
    covariance = np.maximum(np.diag(inverse @ meat @ inverse), np.diag(inverse))
    # a direction without any information has no finite deviation
    deviation = np.where(np.diag(information) <= 0.0, np.inf, np.sqrt(covariance)) * tau
    return dict(zip(_THERMAL, deviation.tolist(), strict=True))


def _fit_together(
    model: DeviceModel, grids: Sequence[GriddedRecording], loops: Loops, values: dict[str, Floats]
) -> Loops:
    """Fit time constant, dead time and all banks at once."""
    tau = model.scalars["thermal.time_constant"]
    start = np.array([0.0, model.scalars["driver.dead_time"] / tau])
    channels = list(loops.fits)
    plays = {name: fit.shape.centre.size for name, fit in loops.fits.items()}
    sizes = [2] + [fit.shape.vector.size for fit in loops.fits.values()]
    ends = np.cumsum(sizes)
    ok = {name: np.isfinite(v) for name, v in values.items()}
    # a residual that is correlated (a wrong loop shape, not noise) counts for as much less as it is correlated
    sigma = {name: _effective_deviation(fit.residual) for name, fit in loops.fits.items()}
    rules = {name: shape_rules(plays[name], sizes[1 + k], values[name]) for k, name in enumerate(channels)}

    def unpack(vector: Floats) -> tuple[DeviceModel, Loops]:
        scalars = {
            **model.scalars,
            _THERMAL[0]: tau * float(np.exp(vector[0])),
            _THERMAL[1]: tau * float(vector[1]),
        }
        at = replace(model, scalars=scalars)
        path = film_path(at, grids, loops.settled)
        fits = {}
        for k, name in enumerate(channels):
            shape = BankShape.of(vector[ends[k] : ends[k + 1]], plays[name])
            output, jacobian = evaluate(shape, path)
            fits[name] = BankFit(shape, values[name] - output, jacobian, 0)
        return at, replace(loops, scalars=scalars, path=path, fits=fits)

    def gap(vector: Floats) -> tuple[Floats, Callable[[], Floats]]:
        at, here = unpack(vector)
        residual = np.concatenate([-here.fits[name].residual[ok[name]] / sigma[name] for name in channels])

        def jacobian() -> Floats:
            columns = _thermal_columns(at, grids, here)
            # the dead time is counted in time constants of the start, the columns in the present one's
            columns[1] = {name: v * tau / at.scalars[_THERMAL[0]] for name, v in columns[1].items()}
            blocks = []
            for k, name in enumerate(channels):
                rows = ok[name]
                block = np.zeros((int(np.count_nonzero(rows)), int(ends[-1])))
                block[:, 0], block[:, 1] = columns[0][name][rows], columns[1][name][rows]
                block[:, ends[k] : ends[k + 1]] = here.fits[name].jacobian[rows]
                blocks.append(block / sigma[name])
            return np.concatenate(blocks)

        return residual, jacobian

    found = levenberg_marquardt(
        gap,
        np.concatenate([start] + [fit.shape.vector for fit in loops.fits.values()]),
        lower=np.concatenate([[-3.0, 0.0]] + [rules[name].lower for name in channels]),
        upper=np.concatenate([[3.0, 20.0]] + [rules[name].upper for name in channels]),
        largest_step=np.concatenate([[0.3, 0.3]] + [rules[name].largest for name in channels]),
        prior=np.concatenate([[0.0, 0.0]] + [rules[name].prior / sigma[name] ** 2 for name in channels]),
        steps=40,
        tolerance=3e-5,
    )
    return unpack(found.theta)[1]


def _effective_deviation(residual: Floats) -> float:
    """Standard deviation of a residual (n,), as large as its correlation makes it for a slow signal."""
    return float(np.sqrt(np.nanmean(residual**2) * correlation_inflation(residual)))


def _without_tangent(vector: Floats, jacobian: Floats) -> Floats:
    """Part of vectors (n, m) that no change of the bank's parameters can make."""
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    j = jacobian / np.where(scale > 0.0, scale, 1.0)
    normal = j.T @ j + 1e-8 * np.eye(j.shape[1])
    return vector - j @ np.linalg.solve(normal, j.T @ vector)
