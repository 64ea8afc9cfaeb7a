"""From calibration recordings to the whole model file: simulation, self-sensing, and what a later diagnosis needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from vo2_models.device.description import DeviceDescription, preset
from vo2_models.device.model import DeviceModel
from vo2_models.diagnosis.current_reading import current_reading
from vo2_models.diagnosis.noise import fit_noise, outliers
from vo2_models.diagnosis.nominal import basis_of, span_of
from vo2_models.effects.adc_quantization import value_step
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import BankShape, fit_bank
from vo2_models.identification.calibration_check import bare_stretches, check_calibration, judge_fit
from vo2_models.identification.command_delay import command_delay
from vo2_models.identification.completion import completed
from vo2_models.identification.device_fit import PLAYS, FitResult, fit_device
from vo2_models.identification.digest import LAGS, digest_of, digest_of_drive
from vo2_models.identification.enrichment import LOCAL
from vo2_models.identification.grid import on_grid
from vo2_models.identification.loop_law import AUTO, held_out_residual, root_mean_square, with_law
from vo2_models.identification.loop_law import PLAYS as PLAYS_LAW
from vo2_models.identification.loops_fit import SECTIONS
from vo2_models.identification.play_dictionary import fold_of
from vo2_models.identification.read_in_time import read_in_time
from vo2_models.identification.rig_fit import fit_rig
from vo2_models.parameters import Value
from vo2_models.recording import (
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
    aligned,
    clock_of,
    in_order,
)
from vo2_models.self_sensing.characterisation import characterise

__all__ = ["fit_model"]

Floats = NDArray[np.float64]
UNSTEADY = 0.02
"""Root mean square distance of samples from their instants, in periods, from which a slope is not good enough for the move."""
_PLAYS_STAY = ("", PLAYS_LAW, AUTO)
"""Choices of a law that leave the plays of a device with a body; another law brings a misfit of its own."""
_AGAIN = 40
"""Iterations of a bank that is fitted to parts of a calibration, from where it stands for all of it."""
LATE, SURE = 0.1, 4.0
"""Dead time that is told of a device without one, in sample periods, and in its own standard deviations."""


def fit_model(
    recordings: Sequence[Recording],
    device: str,
    *,
    plays: int = PLAYS,
    progress: Callable[[str, float], None] | None = None,
    names: Sequence[str] = (),
    self_sensing: bool = True,
    law: str = "",
    gap_limit: float | None = None,
) -> tuple[FitResult, dict[str, Value]]:
    """Fit a device and what builds on it.

    Parameters
    ----------
    recordings : calibration recordings of one device
    device : as `preset` takes it: a shipped device, or the path of a device file
    plays : of each channel's loop, and of law gpi or egpi; a device without body takes it for these two alone
    progress : called with what is being done and the share done, 0 to 1
    names : of the recordings, for the messages
    law : of `loop_law.LAW_CHOICES`; by default plays, and on a device without body plays or Preisach by held-out error
    self_sensing : whether to fit the laws of self-sensing too, which `estimator` needs and `diagnose` does not
    gap_limit : share of a recording that may be gaps, as `check_calibration` takes it

    Returns
    -------
    FitResult : the fit of the simulation, with its residuals and notes
    dict : all flat `model.*` parameters, as `save_model_parameters` writes them

    Raises
    ------
    ValueError : recordings that cannot be fitted; the message says why.
    """
    described = preset(device)
    # the matrices are small: threads inside BLAS would only wait for each other where the processors are busy
    with threadpool_limits(1, user_api="blas"), _own_names(described):
        delay = command_delay(recordings)
        given = [aligned(r, delay) for r in recordings]
        recordings, notes = check_calibration(given, device, names=names, gap_limit=gap_limit)
        _refuse_still(given, recordings, described, names[0] if len(names) == 1 else "recordings")
        description = completed(described, recordings)
        if description.has_body:
            # another law has its own plays: what it stands on does not go by their number
            first = plays if law in _PLAYS_STAY else PLAYS
            result = fit_device(recordings, description.key, plays=first, progress=progress)
            known, told = _better_known(recordings, result)
            if told:
                recordings, notes = known, notes + told
                result = fit_device(recordings, description.key, plays=first, progress=progress)
        else:
            result = fit_rig(recordings, description, law=law, plays=plays, progress=progress)
        if delay:
            notes.append(
                f"commands act {delay:.4g} s after where they stand in the recording, which the model allows for"
            )
            result = replace(result, model=replace(result.model, command_delay=delay))
        notes += _lateness(result, description, recordings[0].sample_period_s)
        if description.has_body and law in _PLAYS_STAY:
            result = _with_misfit(result)
        of_plays = result.model.to_parameters()
        if description.has_body and law not in ("", PLAYS_LAW):
            result = with_law(result, law, plays)
        notes += [*result.notes, *bare_stretches(result), *judge_fit(result, recordings)]
        result = replace(result, notes=tuple(notes))
        parameters = result.model.to_parameters()
        both = [r for r in recordings if RESISTANCE in r and TIP_DEFLECTION in r]
        if both and description.has_body:
            if self_sensing:
                if progress:
                    progress("self-sensing", 0.95)
                # the schemes have laws of their own, which start from plays
                parameters |= characterise(max(both, key=len), of_plays)
            parameters |= _digest(result, recordings[0], both[0] is recordings[0])
        if not description.has_body:
            parameters |= _rig_digest(result, recordings[0])
        return result, parameters


def _refuse_still(
    given: Sequence[Recording], checked: Sequence[Recording], device: DeviceDescription, where: str
) -> None:
    """Refuse recordings without a response that moves, with what those say that `check_calibration` left out."""
    roles = [response.role for response in device.responses]
    if any(role in recording for recording in checked for role in roles):
        return
    found = []
    for role in roles:
        values = np.concatenate([[], *(recording[role] for recording in given if role in recording)])
        values = values[np.isfinite(values)]
        if values.size and np.ptp(values) == 0.0:
            unit = device.units[role]
            found.append(
                f"{device.names[role]} stands still at {values[0]:.6g}{'' if unit == '1' else f' {unit}'}"
            )
    if found:
        raise ValueError(
            f"{where}: {' and '.join(found)} in every sample, need a response that moves with {device.drive_channel}; check "
            "that it is the right column, its lead and converter, and that its range and unit do not round it to one value"
        )


def _with_misfit(result: FitResult) -> FitResult:
    """The fit with what it misses of parts of its calibration: its plays are fitted anew, over the same path, without each."""
    sensors, path = dict(result.model.sensors), result.path
    for role, section in SECTIONS.items():
        law = cast("PlayBank", getattr(result.model, section))
        if role not in result.residuals or not law.present:
            continue
        values, start = law.run(path) + result.residuals[role], BankShape.of_bank(law)
        good = np.isfinite(values)
        fold = fold_of(good)
        if np.count_nonzero(good) - np.bincount(fold[good]).max() < 2 * start.vector.size:
            continue  # too few to fit without a part of them
        again = partial(_left_by_plays, start, path, values)
        sensors[role] = replace(sensors[role], misfit=root_mean_square(held_out_residual(again, good, fold)))
    return replace(result, model=replace(result.model, sensors=sensors))


def _left_by_plays(start: BankShape, path: Floats, values: Floats, given: NDArray[np.bool_]) -> Floats:
    """What plays leave of all values (n,) that are fitted to some of them."""
    fit = fit_bank(path, np.where(given, values, np.nan), start, iterations=_AGAIN)
    return fit.residual_of(path, values)


@contextmanager
def _own_names(device: DeviceDescription) -> Iterator[None]:
    """What is refused is told with the names of the device's own file."""
    try:
        yield
    except ValueError as error:
        told = device.in_own_names(str(error))
        if told == str(error):
            raise
        raise ValueError(told) from error


def _better_known(recordings: Sequence[Recording], result: FitResult) -> tuple[list[Recording], list[str]]:
    """What a first fit shows of the recordings' samples: where they would be at their instants, and which stand alone.

    Returns
    -------
    recordings to be fitted again, and what was found, nothing where the first fit stands
    """
    told, found = [], []
    for recording, end in zip(recordings, result.ends, strict=True):
        even, late = in_order(recording.with_unread())
        if clock_of(recording):
            even = read_in_time(recording, result.model)
        if float(np.std(late)) > UNSTEADY:
            told.append(
                "samples come early or late of a regular clock: they are moved to its instants by the fitted model"
            )
        channels = dict(even.channels)
        for channel, residual in result.residuals.items():
            values = channels.get(channel, np.zeros(0))
            values = values[np.isfinite(values)]
            if not values.size:
                continue
            step = value_step(recording[channel][np.isfinite(recording[channel])])
            if channel == RESISTANCE:  # the residual is of its logarithm
                step /= np.log(10.0) * float(np.quantile(values, 0.1))
            alone = outliers(residual[end - len(even) : end], step)
            if np.any(alone):
                told.append(
                    f"outliers in {channel}: samples that stand alone, {np.count_nonzero(alone)} of them, are left out"
                )
                channels[channel] = np.where(alone, np.nan, channels[channel])
        found.append(replace(even, channels=channels))
    return found, list(dict.fromkeys(told))


def _lateness(result: FitResult, description: DeviceDescription, period: float) -> list[str]:
    """Say that a device which should have no dead time has one: it may be the stamps."""
    found = result.model.scalars["driver.dead_time"]
    std = result.model.uncertainty.get("driver.dead_time", (0.0,))[0]
    if description.dead_time > 0.0 or not description.has_body or found < max(LATE * period, SURE * std):
        return []
    return [
        f"the device answers {found:.4g} +- {std:.1g} s after its drive: a dead time, or stamps that are early by that; "
        "the model has it as driver.dead_time, which all that load it allow for"
    ]


def _digest(result: FitResult, recording: Recording, first: bool) -> dict[str, Value]:
    """What the loops left over along the first recording, for a later diagnosis; nothing where it has no cold start."""
    stop = result.ends[0]
    path, gap, tip = (
        values[1:stop]
        for values in (result.path, result.residuals[RESISTANCE], result.residuals[TIP_DEFLECTION])
    )
    if not first or result.settled or path.size < 100:
        return {}
    basis = basis_of(result.model)
    reach = basis.half_width_k
    inside = (basis.centre_degc[0] - reach, basis.centre_degc[1] + reach)
    # the model's y is -log10 R
    short = digest_of(path, -gap, tip, inside_degc=inside)
    stage = result.residuals.get(STAGE_TEMPERATURE)
    reading, noise = current_reading(recording)
    return replace(
        short,
        current_reading=reading,
        steps=_steps(recording),
        noise_current=noise,
        noise_log_resistance=_noise(path, gap, result, RESISTANCE),
        noise_deflection=_noise(path, tip, result, TIP_DEFLECTION),
        noise_stage=() if stage is None else _noise(path, stage[1:stop], result, STAGE_TEMPERATURE),
        by_lag={
            name: np.column_stack([means.log_resistance, means.deflection])
            for name, columns in _by_lag(result.model, recording).items()
            for means in [digest_of(path, *columns, inside_degc=inside)]
        },
    ).to_parameters()


def _rig_digest(result: FitResult, recording: Recording) -> dict[str, Value]:
    """What the loops of a device without body left over along all recordings; nothing where the drive heats it.

    Its noise stands with the sensors: it is what the law leaves.
    """
    if not result.settled:
        return {}
    path, none = result.path, np.zeros(result.path.size)
    gap, tip = (result.residuals.get(role, none) for role in (RESISTANCE, TIP_DEFLECTION))
    starts = [0, *result.ends[:-1]]
    return replace(digest_of_drive(path, -gap, tip, starts=starts), steps=_steps(recording)).to_parameters()


def _steps(recording: Recording) -> dict[str, float]:
    """Distance of neighbouring values of each channel of a recording, where all of them lie on a comb."""
    return {
        channel: step
        for channel in (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
        if channel in recording and (step := value_step(recording[channel][np.isfinite(recording[channel])]))
    }


def _by_lag(model: DeviceModel, recording: Recording) -> dict[str, tuple[Floats, Floats]]:
    """Change of log10 R and of the deflection along a recording by each lag of the model, per second, the loops held."""
    grid = on_grid(recording)
    step = 0.01 * model.scalars["thermal.time_constant"]

    def simulated(scalars: Mapping[str, float]) -> tuple[Floats, Floats]:
        out = replace(model, scalars=dict(scalars)).simulation.run(grid.current, dt=grid.dt)
        return np.log10(out[:, 1]), out[:, 2]

    before = simulated(model.scalars)
    found = {}
    for name in LAGS:
        after = simulated({**model.scalars, name: model.scalars[name] + step})
        found[name] = ((after[0] - before[0]) / step, (after[1] - before[1]) / step)
    return found


def _noise(path: Floats, residual: Floats, result: FitResult, channel: str) -> tuple[float, ...]:
    """Innovation and colour of a channel's noise: of what even a richer loop shape leaves of the residual."""
    good = np.isfinite(residual)
    if np.count_nonzero(good) < 100:
        return ()
    left = np.where(good, residual, 0.0)
    sensor = result.model.sensors.get(channel)
    level = sensor.noise / (np.log(10.0) if channel == RESISTANCE else 1.0) if sensor else 0.0
    if channel != STAGE_TEMPERATURE and level > 0.0:
        features = replace(basis_of(result.model), local=LOCAL).features(
            path, span=span_of(result.model.device)[channel]
        )
        used = features[good] / level
        gram = used.T @ used
        gram[np.diag_indices_from(gram)] += 1.0
        left[good] -= level * (used @ np.linalg.solve(gram, used.T @ (left[good] / level)))
    found = fit_noise(left, good)
    return found.innovation, *found.ar
