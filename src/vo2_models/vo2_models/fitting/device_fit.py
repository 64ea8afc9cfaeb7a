"""From calibration recordings to the complete fitted simulation of a device, without any effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vo2_models.device.bank import PlayBank
from vo2_models.device.model import DeviceModel, SensorModel
from vo2_models.device.presets import preset
from vo2_models.fitting.bank_fit import BankFit, evaluate, fit_bank, starting_shape
from vo2_models.fitting.bank_uncertainty import bank_uncertainty
from vo2_models.fitting.grid import GriddedRecording, on_grid
from vo2_models.fitting.noise import correlation_inflation, noise_of_residual, residual_colour
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION, Recording

__all__ = ["FitResult", "fit_device"]

Floats = NDArray[np.float64]
PLAYS = 12
"""Plays of each bank."""
COLD = -300.0
"""Temperature [degC] put between two recordings, which brings every play back to its cold saturation."""
SECTIONS = {RESISTANCE: "resistance", TIP_DEFLECTION: "deflection"}


@dataclass(frozen=True)
class FitResult:
    """What a fit found.

    Attributes
    ----------
    model : the fitted simulation, with uncertainties and noise levels
    residuals : channel -> (n,) measured minus model; resistance in log10 ohm with the sign of -log10 R
    settled : whether the recordings were taken to start settled at their first current instead of from a cold rest
    notes : what the recordings did not allow, one sentence each
    """

    model: DeviceModel
    residuals: dict[str, Floats] = field(repr=False)
    settled: bool
    notes: tuple[str, ...]


def fit_device(
    recordings: Sequence[Recording],
    device: str,
    *,
    plays: int = PLAYS,
    progress: Callable[[str, float], None] | None = None,
) -> FitResult:
    """Fit driver, thermal model, resistance, deflection and sensors to recordings of one device.

    With a stage temperature the thermal model is fitted to it. Without, temperature has no scale of its
    own: ambient and gain are the preset's, and time constant and dead time are found together with the loops, as far
    as the recordings have transients.

    Parameters
    ----------
    recordings : each from a cold rest, or each settled at its first current
    device : preset id
    plays : number of plays per channel
    progress : called with what is being done and the share done, 0 to 1

    Raises
    ------
    ValueError : unknown device, or recordings without current, without any of resistance and deflection, too short,
        or in which the current hardly changes.
    """
    nominal = preset(device)
    say = progress or (lambda text, share: None)
    grids = [on_grid(recording) for recording in recordings]
    if not grids:
        raise ValueError("recordings: found none, need at least one")
    _check_excited(grids, device)
    say("thermal model", 0.0)
    notes: list[str] = []
    model = DeviceModel(device)
    thermal_std: dict[str, float] = {}
    if all(STAGE_TEMPERATURE in grid.measured for grid in grids):
        model, thermal_std = _fit_stage(model, grids)
    elif nominal.measures_temperature:
        notes.append("no stage temperature: the temperature scale is the preset's")
    candidates = [_fit_loops(model, grids, plays, settled=False, thermal=not thermal_std, say=say)]
    if _starts_badly(candidates[0], grids, candidates[0].scalars["thermal.time_constant"]):
        candidates.append(_fit_loops(model, grids, plays, settled=True, thermal=not thermal_std, say=say))
    best = min(candidates, key=lambda loops: loops.cost)
    settled = best is not candidates[0]
    if settled:
        notes.append(
            "the recording does not start from a cold rest: it is taken to start settled at its first current"
        )
    notes += best.notes
    say("noise and uncertainty", 0.9)
    return _assemble(model, best, grids, settled, thermal_std, notes)


@dataclass(frozen=True)
class _Loops:
    """Both banks fitted over one temperature path."""

    scalars: dict[str, float]
    std: dict[str, float]
    path: Floats
    fits: dict[str, BankFit]
    settled: bool
    notes: tuple[str, ...] = ()

    @property
    def cost(self) -> float:
        return sum(float(np.log(np.nanmean(np.square(f.residual)))) for f in self.fits.values())


def _check_excited(grids: Sequence[GriddedRecording], device: str) -> None:
    nominal = preset(device)
    low, high = sorted(nominal.operating_range)
    current = np.concatenate([grid.current for grid in grids])
    channels = {name for grid in grids for name in grid.measured}
    if not channels & set(SECTIONS):
        raise ValueError(
            f"recordings: found no {RESISTANCE} and no {TIP_DEFLECTION}, need at least one of them"
        )
    if np.ptp(current) < 0.1 * (high - low):
        raise ValueError(
            f"recordings: found a current between {current.min():g} and {current.max():g} A, need one that "
            f"spans at least a tenth of the operating range {low:g} to {high:g} A of device {device}"
        )


def _film_path(model: DeviceModel, grids: Sequence[GriddedRecording], settled: bool) -> Floats:
    """Film temperature of all recordings one behind the other, each preceded by one cold sample."""
    parts = []
    for grid in grids:
        state = model.simulation.settled_state(grid.current[0], grid.dt) if settled else None
        out = model.simulation.run(grid.current, dt=grid.dt, state=state)
        parts += [np.array([COLD]), out[:, 5]]
    return np.concatenate(parts)


def _values(grids: Sequence[GriddedRecording], channel: str) -> Floats:
    """Measured values along the path of `_film_path`."""
    parts = []
    for grid in grids:
        missing = np.full(grid.current.size, np.nan)
        parts += [np.array([np.nan]), grid.measured.get(channel, missing)]
    return np.concatenate(parts)


def _fit_stage(model: DeviceModel, grids: Sequence[GriddedRecording]) -> tuple[DeviceModel, dict[str, float]]:
    """Fit ambient, gain, time constant and dead time to the stage temperature."""
    nominal = preset(model.device)
    gain = "thermal.square_gain" if nominal.square_gain else "thermal.linear_gain"
    names = ["thermal.ambient", gain, "thermal.time_constant", "driver.dead_time"]
    start = np.array([model.scalars[name] for name in names])
    scale = np.array([1.0, abs(start[1]) * 0.02, start[2] * 0.05, max(start[3] * 0.1, grids[0].dt)])

    def gap(vector: Floats, settled: bool) -> Floats:
        scalars = dict(zip(names, vector, strict=True))
        scalars["driver.dead_time"] = max(scalars["driver.dead_time"], 0.0)
        trial = replace(model, scalars={**model.scalars, **scalars})
        parts = []
        for grid in grids:
            state = trial.simulation.settled_state(grid.current[0], grid.dt) if settled else None
            parts.append(
                trial.simulation.run(grid.current, dt=grid.dt, state=state)[:, 3]
                - grid.measured[STAGE_TEMPERATURE]
            )
        joined = np.concatenate(parts)
        return np.where(np.isfinite(joined), joined, 0.0)

    results = []
    for settled in (False, True):
        low = np.array([-50.0, -np.inf if start[1] < 0 else 0.0, 0.05 * start[2], 0.0])
        high = np.array(
            [150.0, 0.0 if start[1] < 0 else np.inf, 20.0 * start[2], 100.0 * grids[0].dt + start[3]]
        )
        results.append(
            least_squares(
                gap, start, args=(settled,), x_scale=scale, bounds=(low, high), loss="soft_l1", f_scale=0.3
            )
        )
    best = min(results, key=lambda result: result.cost)
    residual = best.fun
    variance = float(np.mean(residual**2)) * correlation_inflation(residual)
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * variance
    found = dict(zip(names, map(float, best.x), strict=True))
    std = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return replace(model, scalars={**model.scalars, **found}), std


def _fit_loops(
    model: DeviceModel,
    grids: Sequence[GriddedRecording],
    plays: int,
    *,
    settled: bool,
    thermal: bool,
    say: Callable[[str, float], None],
) -> _Loops:
    """Fit the banks, and (where `thermal`) time constant and dead time along with them."""
    channels = [name for name in SECTIONS if any(name in grid.measured for grid in grids)]
    path = _film_path(model, grids, settled)
    values = {name: _values(grids, name) for name in channels}
    fits = {}
    for k, name in enumerate(channels):
        say(f"loop of {name}", 0.1 + 0.25 * k)
        start = starting_shape(path, values[name], plays=plays)
        fits[name] = fit_bank(path, values[name], start)
    scalars = dict(model.scalars)
    std: dict[str, float] = {}
    notes: list[str] = []
    for turn in range(5 if thermal else 0):
        say("transients", 0.6 + 0.05 * turn)
        trial = replace(model, scalars=scalars)
        moved, std, notes = _thermal_step(trial, grids, path, fits, settled)
        change = abs(np.log(moved["thermal.time_constant"] / scalars["thermal.time_constant"]))
        change += (
            abs(moved["driver.dead_time"] - scalars["driver.dead_time"]) / scalars["thermal.time_constant"]
        )
        if change < 1e-3:
            break
        scalars = moved
        path = _film_path(replace(model, scalars=scalars), grids, settled)
        fits = {name: fit_bank(path, values[name], fit.shape, iterations=25) for name, fit in fits.items()}
    return _Loops(scalars, std, path, fits, settled, tuple(notes))


def _thermal_step(
    model: DeviceModel,
    grids: Sequence[GriddedRecording],
    path: Floats,
    fits: dict[str, BankFit],
    settled: bool,
) -> tuple[dict[str, float], dict[str, float], list[str]]:
    """One Gauss-Newton step of time constant and dead time with the banks free (their tangent projected out)."""
    scalars = dict(model.scalars)
    tau = scalars["thermal.time_constant"]
    dt = grids[0].dt
    moves = {"thermal.time_constant": 0.02 * tau, "driver.dead_time": 0.05 * max(dt, 0.1 * tau)}
    columns, gaps = [], []
    for name, step in moves.items():
        other = _film_path(replace(model, scalars=scalars | {name: scalars[name] + step}), grids, settled)
        parts = []
        for fit in fits.values():
            ok = np.isfinite(fit.residual)
            sigma = float(np.sqrt(np.mean(fit.residual[ok] ** 2)))
            slope = (evaluate(fit.shape, other)[0] - evaluate(fit.shape, path)[0])[ok] / step
            parts.append(_without_tangent(slope, fit.jacobian[ok]) / sigma)
        columns.append(np.concatenate(parts))
    for fit in fits.values():
        ok = np.isfinite(fit.residual)
        sigma = float(np.sqrt(np.mean(fit.residual[ok] ** 2)))
        gaps.append(_without_tangent(fit.residual[ok], fit.jacobian[ok]) / sigma)
    gap = np.concatenate(gaps)
    inflation = correlation_inflation(gap)
    matrix = np.column_stack(columns)
    names = list(moves)
    notes = []
    free = list(range(2))
    normal = matrix.T @ matrix
    if 1.0 / np.sqrt(max(normal[0, 0], 1e-300)) * np.sqrt(inflation) > 0.25 * tau:
        notes.append("no transients in the recording: time constant and dead time are the preset's")
        return scalars, {}, notes
    step_now, spread = _solve(matrix, gap, free, inflation)
    dead = scalars["driver.dead_time"] + step_now[1]
    if dead < 2.0 * spread[1]:
        # not told apart from the nominal dead time's lower bound: leave it at zero or at the preset's value
        back = preset(model.device).dead_time - scalars["driver.dead_time"]
        step_now, spread_tau = _solve(matrix[:, :1], gap - matrix[:, 1] * back, [0], inflation)
        step_now, spread = np.array([step_now[0], back]), np.array([spread_tau[0], spread[1]])
    scalars[names[0]] = float(np.clip(tau + step_now[0], 0.6 * tau, 1.6 * tau))
    scalars[names[1]] = float(max(scalars[names[1]] + step_now[1], 0.0))
    return scalars, dict(zip(names, spread.tolist(), strict=True)), notes


def _solve(matrix: Floats, gap: Floats, free: list[int], inflation: float) -> tuple[Floats, Floats]:
    """Least-squares step and its standard deviations for residuals of unit variance."""
    inverse = np.linalg.pinv(matrix[:, free].T @ matrix[:, free])
    return inverse @ (matrix[:, free].T @ gap), np.sqrt(np.diag(inverse) * inflation)


def _without_tangent(vector: Floats, jacobian: Floats) -> Floats:
    """Part of a vector (n,) that no change of the bank's parameters can make."""
    scale = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    j = jacobian / np.where(scale > 0.0, scale, 1.0)
    normal = j.T @ j + 1e-8 * np.eye(j.shape[1])
    return vector - j @ np.linalg.solve(normal, j.T @ vector)


def _starts_badly(loops: _Loops, grids: Sequence[GriddedRecording], tau: float) -> bool:
    """Whether the first five time constants fit far worse than the rest, as after a wrong initial state."""
    count = max(int(5.0 * tau / grids[0].dt), 4)
    for fit in loops.fits.values():
        first = fit.residual[1 : count + 1]
        rest = fit.residual[count + 1 :]
        if not (np.any(np.isfinite(first)) and np.any(np.isfinite(rest))):
            continue
        if np.nanmean(first**2) > 25.0 * np.nanmean(rest**2):
            return True
    return False


def _assemble(
    model: DeviceModel,
    loops: _Loops,
    grids: Sequence[GriddedRecording],
    settled: bool,
    thermal_std: dict[str, float],
    notes: list[str],
) -> FitResult:
    banks: dict[str, PlayBank] = {}
    sensors: dict[str, SensorModel] = {}
    uncertainty: dict[str, tuple[float, ...]] = {
        name: (value,) for name, value in (thermal_std | loops.std).items() if np.isfinite(value)
    }
    residuals = {}
    for channel, fit in loops.fits.items():
        section = SECTIONS[channel]
        banks[section] = fit.shape.bank()
        uncertainty |= {f"{section}.{k}": v for k, v in bank_uncertainty(fit).items()}
        residuals[channel] = fit.residual
        # y = -log10 R, and R's noise is relative
        sensors[channel] = _sensor(
            fit.residual, evaluate(fit.shape, loops.path)[0], np.log(10.0) if channel == RESISTANCE else 1.0
        )
    fitted = replace(model, scalars=loops.scalars)
    if thermal_std:
        parts = []
        for grid in grids:
            state = fitted.simulation.settled_state(grid.current[0], grid.dt) if settled else None
            stage = fitted.simulation.run(grid.current, dt=grid.dt, state=state)[:, 3]
            parts += [np.array([np.nan]), grid.measured[STAGE_TEMPERATURE] - stage]
        residuals[STAGE_TEMPERATURE] = np.concatenate(parts)
        sensors[STAGE_TEMPERATURE] = _sensor(residuals[STAGE_TEMPERATURE], loops.path, 1.0)
    for channel, section in SECTIONS.items():
        if channel not in loops.fits:
            notes.append(f"no {channel}: the model has no {section}")
    return FitResult(
        model=replace(
            fitted,
            resistance=banks.get("resistance", PlayBank()),
            deflection=banks.get("deflection", PlayBank()),
            sensors=sensors,
            uncertainty=uncertainty,
        ),
        residuals=residuals,
        settled=settled,
        notes=tuple(notes),
    )


def _sensor(residual: Floats, signal: Floats, factor: float) -> SensorModel:
    level, colour = noise_of_residual(residual, signal)
    return SensorModel(
        noise=factor * level,
        colour=(colour,) if colour else (),
        residual=float(np.sqrt(np.nanmean(residual**2))),
        residual_colour=residual_colour(residual),
    )
