"""From calibration recordings to the complete fitted simulation of a device, without any effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vo2_models.device.description import DeviceDescription, preset
from vo2_models.device.model import DeviceModel, SensorModel
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import evaluate
from vo2_models.identification.bank_uncertainty import bank_uncertainty
from vo2_models.identification.grid import GriddedRecording, on_grid
from vo2_models.identification.loops_fit import SECTIONS, Loops, fit_loops
from vo2_models.identification.noise import correlation_inflation, noise_of_residual, residual_colour
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION, Recording

__all__ = ["FitResult", "fit_device"]

Floats = NDArray[np.float64]
PLAYS = 12
"""Plays of each bank."""
_WARM = 0.5
"""Share of the cost of a cold start below which a stage's temperature says that a recording began settled."""


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

    Returns
    -------
    FitResult : model, residuals and notes

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
    if nominal.power_gain:
        grids, gain = _heating(grids, nominal)
        model = replace(model, scalars={**model.scalars, **gain})
    thermal_std: dict[str, float] = {}
    warm = False
    if all(STAGE_TEMPERATURE in grid.measured for grid in grids):
        model, thermal_std, warm = _fit_stage(model, grids)
    elif nominal.measures_temperature:
        notes.append("no stage temperature: the temperature scale is the preset's")
    best, settled = fit_loops(model, grids, plays, settled=warm, thermal=not thermal_std, say=say), warm
    if not warm and _starts_badly(best, grids, best.scalars["thermal.time_constant"]):
        other = fit_loops(model, grids, plays, settled=True, thermal=not thermal_std, say=say)
        best, settled = (other, True) if other.cost < best.cost else (best, False)
    if settled:
        notes.append(
            "the recording does not start from a cold rest: it is taken to start settled at its first current"
        )
    notes += best.notes
    say("noise and uncertainty", 0.9)
    found = _assemble(model, best, grids, settled, thermal_std, notes)
    return (
        _own_heater(found, gain["thermal.square_gain"] / nominal.power_gain) if nominal.power_gain else found
    )


def _heating(
    grids: Sequence[GriddedRecording], nominal: DeviceDescription
) -> tuple[list[GriddedRecording], dict[str, float]]:
    """Recordings whose drive heats a constant resistance as theirs heats the one measured, and the gains that go with it.

    I^2 R = I'^2 R0 with I' = I sqrt(R / R0), of a voltage V^2 / R = V'^2 / R0: R0 is that end of what was measured at which
    no drive becomes larger. Over a sample the power at its two ends is averaged.
    """
    sign = 1.0 if nominal.drive_unit == "A" else -1.0
    powers = []
    for grid in grids:
        y = grid.measured.get(RESISTANCE, np.empty(0))
        seen = np.flatnonzero(np.isfinite(y))
        if not seen.size:
            raise ValueError(
                f"recordings: found one without {nominal.names[RESISTANCE]}, need it in each: the power in it heats "
                "(body: power_gain in the device file)"
            )
        power = 10.0 ** (-sign * np.interp(np.arange(y.size), seen, y[seen]))
        powers.append(0.5 * (np.r_[power[0], power[:-1]] + power))
    most = max(float(power.max()) for power in powers)
    as_heated = [
        replace(grid, current=grid.current * np.sqrt(power / most))
        for grid, power in zip(grids, powers, strict=True)
    ]
    return as_heated, {"thermal.square_gain": nominal.power_gain * most, "thermal.power_gain": 0.0}


def _own_heater(found: FitResult, reference: float) -> FitResult:
    """The fit with its gain per squared drive at a resistance (1/ohm of a voltage) as one per power in the film."""
    model = found.model
    scalars = dict(model.scalars)
    scalars["thermal.power_gain"] = scalars["thermal.square_gain"] / reference
    uncertainty = dict(model.uncertainty)
    if known := uncertainty.pop("thermal.square_gain", None):
        uncertainty["thermal.power_gain"] = (known[0] / reference,)
    scalars["thermal.square_gain"] = 0.0
    return replace(found, model=replace(model, scalars=scalars, uncertainty=uncertainty))


def _check_excited(grids: Sequence[GriddedRecording], device: str) -> None:
    nominal = preset(device)
    low, high = sorted(nominal.operating_range)
    unit = nominal.drive_unit
    current = np.concatenate([grid.current for grid in grids])
    channels = {name for grid in grids for name in grid.measured}
    if not channels & set(SECTIONS):
        raise ValueError(
            f"recordings: found no {RESISTANCE} and no {TIP_DEFLECTION}, need at least one of them"
        )
    if np.ptp(current) < 0.1 * (high - low):
        raise ValueError(
            f"recordings: found {nominal.drive_channel} between {current.min():g} and {current.max():g} {unit}, need one that "
            f"spans at least a tenth of the operating range {low:g} to {high:g} {unit} of device {nominal.id}: is one of them in "
            "another unit?"
        )


def _fit_stage(
    model: DeviceModel, grids: Sequence[GriddedRecording]
) -> tuple[DeviceModel, dict[str, float], bool]:
    """Fit ambient, gain, time constant and dead time to the stage temperature, and whether it starts settled.

    A film that is far below its transition when a recording begins does not tell.
    """
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
    cold, warm = results
    settled = warm.cost < _WARM * cold.cost
    best = warm if settled else cold
    residual = best.fun
    variance = float(np.mean(residual**2)) * correlation_inflation(residual)
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * variance
    found = dict(zip(names, map(float, best.x), strict=True))
    std = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    return replace(model, scalars={**model.scalars, **found}), std, settled


def _starts_badly(loops: Loops, grids: Sequence[GriddedRecording], tau: float) -> bool:
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
    loops: Loops,
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
