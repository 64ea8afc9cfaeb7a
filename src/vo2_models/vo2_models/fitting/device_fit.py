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
from vo2_models.fitting.bank_fit import BankFit, BankShape, evaluate, fit_bank, shape_rules, starting_shape
from vo2_models.fitting.bank_uncertainty import bank_uncertainty
from vo2_models.fitting.grid import GriddedRecording, on_grid
from vo2_models.fitting.levenberg_marquardt import levenberg_marquardt
from vo2_models.fitting.noise import correlation_inflation, noise_of_residual, residual_colour
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION, Recording

__all__ = ["FitResult", "fit_device"]

Floats = NDArray[np.float64]
PLAYS = 12
"""Plays of each bank."""
COLD = -300.0
"""Temperature [degC] put between two recordings, which brings every play back to its cold saturation."""
STAIRCASE = 0.25
"""Recordings whose steps are all smaller than this share of the range do not pin down the time constant."""
STAIRCASE_BIAS = 0.018
"""Relative error (one standard deviation) that the time constant then has beside its scatter: over the simulated
devices 1 to 8, calibrated with a damped oscillation of 20 levels, it was 1.7 % (at most 3.5 %); with 60 random levels
behind it, 0.1 % (at most 0.2 %)."""
SECTIONS = {RESISTANCE: "resistance", TIP_DEFLECTION: "deflection"}


@dataclass(frozen=True)
class FitResult:
    """What a fit found.

    Attributes
    ----------
    model : the fitted simulation, with uncertainties and noise levels
    path : (n,) film temperature of the model [degC] along all recordings; each is preceded by one cold sample
    ends : index behind the last sample of each recording
    residuals : channel -> (n,) measured minus model along the path; resistance in log10 ohm with the sign of -log10 R
    settled : whether the recordings were taken to start settled at their first current instead of from a cold rest
    notes : what the recordings did not allow, one sentence each
    """

    model: DeviceModel
    path: Floats = field(repr=False)
    ends: tuple[int, ...]
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
    loops = _Loops(dict(model.scalars), {}, path, fits, settled)
    if not thermal:
        return loops
    say("transients", 0.6)
    spread = _thermal_spread(model, grids, loops)
    tau = model.scalars["thermal.time_constant"]
    if spread["thermal.time_constant"] > 0.25 * tau:
        note = "no transients in the recording: time constant and dead time are the preset's"
        return replace(loops, notes=(note,))
    loops = _fit_together(model, grids, loops, values)
    std = _thermal_spread(replace(model, scalars=loops.scalars), grids, loops)
    if _largest_jump(model, grids) > STAIRCASE:
        return replace(loops, std=std)
    tau = loops.scalars["thermal.time_constant"]
    std["thermal.time_constant"] = max(std["thermal.time_constant"], STAIRCASE_BIAS * tau)
    note = (
        "the current moves in small steps only, which a slightly wrong loop imitates: the time constant may be "
        f"{100 * STAIRCASE_BIAS:.1f} % off; some large steps, such as random levels, would settle it"
    )
    return replace(loops, std=std, notes=(note,))


def _largest_jump(model: DeviceModel, grids: Sequence[GriddedRecording]) -> float:
    """Largest step of the steady temperature between neighbouring samples, as a share of its range (99.5 % quantile)."""
    linear, square = model.scalars["thermal.linear_gain"], model.scalars["thermal.square_gain"]
    targets = [linear * grid.current + square * np.square(grid.current) for grid in grids]
    jumps = np.concatenate([np.abs(np.diff(target)) for target in targets])
    return float(np.quantile(jumps, 0.995) / np.ptp(np.concatenate(targets)))


_THERMAL = ("thermal.time_constant", "driver.dead_time")


def _thermal_columns(
    model: DeviceModel, grids: Sequence[GriddedRecording], loops: _Loops
) -> list[dict[str, Floats]]:
    """Derivative of each channel by the logarithm of the time constant and by the dead time in time constants."""
    tau = model.scalars["thermal.time_constant"]
    found = []
    for name, step in zip(_THERMAL, (0.01, 0.02), strict=True):
        moved = (
            model.scalars[name] * (1.0 + step) if name == _THERMAL[0] else model.scalars[name] + step * tau
        )
        other = _film_path(replace(model, scalars={**model.scalars, name: moved}), grids, loops.settled)
        found.append(
            {
                channel: (evaluate(fit.shape, other)[0] - evaluate(fit.shape, loops.path)[0]) / step
                for channel, fit in loops.fits.items()
            }
        )
    return found


def _thermal_spread(model: DeviceModel, grids: Sequence[GriddedRecording], loops: _Loops) -> dict[str, float]:
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
    model: DeviceModel, grids: Sequence[GriddedRecording], loops: _Loops, values: dict[str, Floats]
) -> _Loops:
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

    def unpack(vector: Floats) -> tuple[DeviceModel, _Loops]:
        scalars = {
            **model.scalars,
            _THERMAL[0]: tau * float(np.exp(vector[0])),
            _THERMAL[1]: tau * float(vector[1]),
        }
        at = replace(model, scalars=scalars)
        path = _film_path(at, grids, loops.settled)
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
        path=loops.path,
        ends=tuple(int(n) for n in np.cumsum([grid.current.size + 1 for grid in grids])),
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
