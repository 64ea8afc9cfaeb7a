"""Fit of any rig: a device without a heated body, whose loops lie over the drive itself."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.description import DeviceDescription
from vo2_models.device.model import DeviceModel, SensorModel
from vo2_models.diagnosis.noise import LONGEST
from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.law_fit import FITTED
from vo2_models.hysteresis.law_fit import PLAYS as COUNT
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import BankFit, Late, evaluate, fit_bank
from vo2_models.identification.bank_uncertainty import bank_uncertainty
from vo2_models.identification.completion import noise_of_recordings
from vo2_models.identification.coverage import coverage_of, misfit_note
from vo2_models.identification.device_fit import FitResult
from vo2_models.identification.grid import GriddedRecording, on_grid
from vo2_models.identification.loop_law import (
    AUTO,
    MARGIN,
    PLAYS,
    LoopLaw,
    better_of,
    fit_loop_law,
    folds_of_recordings,
    root_mean_square,
)
from vo2_models.identification.loops_fit import SECTIONS, film_path
from vo2_models.identification.noise import residual_colour
from vo2_models.identification.play_dictionary import (
    FOLDS,
    PlayDictionary,
    fit_dictionary,
    fold_of,
)
from vo2_models.identification.preisach_choice import choose_preisach
from vo2_models.identification.rig_dynamics import (
    RigDynamics,
    choose_dynamics,
    loop_path,
    relaxing,
    ringing,
)
from vo2_models.identification.rig_heat import RigHeat, choose_heat, free_run, heat_path, heat_scalars
from vo2_models.identification.rig_plays import behind_all, bounded_loop, dynamics_of_plays
from vo2_models.identification.rig_start import with_known_starts
from vo2_models.identification.steepness import steep_misfit, travel_of, unevenness, variation
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording

__all__ = ["fit_rig"]

Floats = NDArray[np.float64]
_GRIDS = ({"centres": 20, "widths": 10}, {"centres": 60, "widths": 8})
"""Grids of plays, smooth and sharp."""
_REFINED = (3, 8, 24)
"""Numbers of the heaviest plays that Levenberg-Marquardt moves, tried against all of them as they stand."""
_STEPS = 40
_ROUNDS = 2
_RELAXING = ("", PLAYS, AUTO)
"""Choices of a law that leave plays, the only ones that are fitted behind a relaxation."""
_HELD = ", given a drive that is held over each sample (driver.held)"
_BOUNDED = ("", AUTO, "bounded_plays")
"""Choices of a law that leave bounded plays, the only ones that a lag of the sensor is sought with."""
LAG_OFF = 0.02
"""Standard deviation of a found lag, as a share of it: on two looked-at rigs that others wrote it was 1 % off."""
_SHORT, _LONGEST = 2_000, 20_000
"""Samples below which all held-out parts judge, and above which the plays are not moved: the convex fit stands."""


def fit_rig(
    recordings: Sequence[Recording],
    device: DeviceDescription,
    *,
    law: str = "",
    plays: int = COUNT,
    progress: Callable[[str, float], None] | None = None,
) -> FitResult:
    """Fit the loops of a device without body, and how they follow the drive.

    Sense, lag or delay and memoryless part are chosen by held-out evidence (`rig_dynamics`); so is whether the drive
    heats (`rig_heat`), whether the plays stand on a grid or are moved, and whether a Preisach law does better. Each
    sensor's `misfit` is the error on the held-out parts.

    Parameters
    ----------
    recordings : in roles
    device : completed by what the recordings tell
    law : of `loop_law.LAW_CHOICES`; by default plays or Preisach, whichever predicts held-out parts better
    plays : of law gpi or egpi; elsewhere held-out parts choose their number
    progress : called with what is being done and the share done, 0 to 1

    Returns
    -------
    FitResult : model, residuals and notes

    Raises
    ------
    ValueError : no drive, no response, a drive that hardly changes, or too few samples.
    """
    say = progress or (lambda text, share: None)
    begun: Sequence[GriddedRecording] = [on_grid(recording) for recording in recordings]
    grids = begun
    roles = [
        role for role in SECTIONS if role in device.channels and any(role in grid.measured for grid in grids)
    ]
    if not roles:
        names = ", ".join(response.channel for response in device.responses)
        raise ValueError(f"recordings: found none of the responses {names}, need at least one")
    low, high = sorted(device.operating_range)
    drive = np.concatenate([grid.current for grid in grids])
    if np.ptp(drive) < 0.1 * (high - low):
        raise ValueError(
            f"recordings: found {device.drive_channel} between {drive.min():g} and {drive.max():g} {device.drive_unit}, "
            f"need one that spans at least a tenth of the operating range {low:g} to {high:g} of device {device.id}"
        )
    values = {role: _along(grids, role) for role in roles}
    coverage = coverage_of(grids, device)
    dynamics = choose_dynamics(
        grids, device, values, rates=not coverage.one_rate, relaxes=law in _RELAXING,
        progress=lambda share: say("lag, delay and sense", 0.4 * share),
    )  # fmt: skip
    known = with_known_starts(grids, _assembled(grids, device, RigHeat("drive", dynamics))[2], values)
    if known is not grids:
        grids, values = known, {role: _along(known, role) for role in roles}
        dynamics = choose_dynamics(
            grids, device, values, rates=not coverage.one_rate, relaxes=law in _RELAXING,
            progress=lambda share: say("lag, delay and sense", 0.4 * share),
        )  # fmt: skip
    heat = RigHeat("drive", dynamics)
    if not coverage.one_rate:  # over one rate another coordinate is another shape of the loop
        say("heat in the film", 0.4)
        heat = choose_heat(grids, device, values, dynamics)
    if heat.kind == "drive":
        heat = replace(heat, dynamics=_by_the_law(grids, device, values, heat.dynamics))
    whole, folds = device, {role: _folds(grids, values[role]) for role in roles}
    device, model, path = _assembled(grids, whole, heat)
    fits: dict[str, LoopLaw] = {}
    for k, role in enumerate(roles):
        say(f"loop of {device.names[role]}", 0.6 + 0.2 * k / len(roles))
        late = _late(grids, device, heat.dynamics, role)
        fits[role] = _loop(path, values[role], heat.dynamics.degree, folds[role], law, late, plays)
    if len(roles) == 1 and heat.kind == "drive" and not coverage.one_rate and law in _BOUNDED:
        role = roles[0]
        say("lags beside plays between ends", 0.8)
        better = dynamics_of_plays(grids, whole, values[role], folds[role], heat.dynamics, fits[role].misfit)
        if better:
            heat = replace(heat, dynamics=better)
            device, model, path = _assembled(grids, whole, heat)
            fits[role] = bounded_loop(path, values[role], folds[role], behind_all(grids, better))
    dynamics = heat.dynamics
    notes = [*coverage.notes, *heat.notes(device)]
    if known is not begun:
        notes.append(
            "the recording begins at a state that its drive does not show, relaxed or demagnetised for one: what comes before "
            f"{device.drive_channel} has been at an end of its range is left out; begin with one full cycle"
        )
    if dynamics.frequency:
        notes.append(
            f"{device.names[TIP_DEFLECTION]} rings at {dynamics.frequency:.4g} Hz with a damping ratio of {dynamics.damping:.2g} "
            "(cantilever_resonance in the model)" + _HELD * dynamics.held
        )
    if dynamics.relaxation:
        notes.append(
            f"what has hysteresis relaxes with a time constant of {dynamics.relaxation:.3g} s, the memoryless part does not "
            "(transition_kinetics in the model)"
        )
    if dynamics.behind:
        notes.append(
            f"{device.names[roles[0]]} follows what has hysteresis with a time constant of {dynamics.behind:.3g} s "
            "(sensor_lag in the model)" + _HELD * dynamics.held
        )
    laws: dict[str, Law] = {}
    sensors: dict[str, SensorModel] = {}
    residuals: dict[str, Floats] = {}
    lag = model.scalars["thermal.time_constant"]
    uncertainty: dict[str, tuple[float, ...]] = (
        {"thermal.time_constant": (LAG_OFF * lag,)} if dynamics.lag else {}
    )
    for role, fit in fits.items():
        channel = device.names[role]
        notes.append(f"{channel}: {fit.words}")
        section = SECTIONS[role]
        laws[section] = fit.law
        uncertainty |= {f"{section}.{name}": std for name, std in fit.uncertainty.items()}
        run = (
            _run_freely(_with_laws(model, laws), grids, role, values[role], fit, heat) if model.heats else fit
        )
        residuals[role] = run.residual
        noise = device.noise.get(role, noise_of_recordings(recordings, role))
        level = noise / np.log(10.0) if role == RESISTANCE else noise
        sensor = SensorModel(
            noise=noise,
            residual=float(np.sqrt(np.nanmean(run.residual**2))),
            misfit=run.misfit,
            residual_colour=residual_colour(run.residual, LONGEST),
        )
        sensors[role] = sensor if model.heats else _uneven(device, sensor, path, values[role], fit, level)
        unit = f"log10 {device.units[role]}" if role == RESISTANCE else device.units[role]
        if note := misfit_note(grids, device, channel, unit, run.residual, values[role], level):
            notes.append(note)
    return FitResult(
        model=replace(
            _with_laws(model, laws),
            sensors=sensors,
            uncertainty=uncertainty,
        ),
        path=path,
        ends=tuple(int(n) for n in np.cumsum([grid.current.size + 1 for grid in grids])),
        residuals=residuals,
        settled=not model.heats,
        notes=tuple(notes),
    )


def _uneven(
    device: DeviceDescription, sensor: SensorModel, path: Floats, values: Floats, fit: LoopLaw, noise: float
) -> SensorModel:
    """The sensor with two sizes of its misfit, where held-out parts show two."""
    if fit.held_out is None:
        return sensor
    seen = np.flatnonzero(np.isfinite(fit.residual))
    response = np.interp(np.arange(path.size), seen, (values - fit.residual)[seen])
    flat, steep = steep_misfit(fit.held_out, variation(path, response, travel_of(device)), noise)
    if not flat:
        return sensor
    two = replace(sensor, misfit_flat=flat, misfit_steep=steep)
    left = fit.residual / unevenness(device, two, path, response)
    return replace(two, misfit_colour=residual_colour(left, LONGEST))


def _folds(grids: Sequence[GriddedRecording], values: Floats) -> NDArray[np.int64]:
    return folds_of_recordings([grid.current for grid in grids], fold_of(np.isfinite(values)))


def _late(
    grids: Sequence[GriddedRecording], device: DeviceDescription, dynamics: RigDynamics, role: str
) -> Late | None:
    """What a response goes through behind its loops, of what `choose_dynamics` finds."""
    rings = ringing(grids, dynamics) if role == TIP_DEFLECTION else None
    return rings or relaxing(grids, device, dynamics)


def _assembled(
    grids: Sequence[GriddedRecording], device: DeviceDescription, heat: RigHeat
) -> tuple[DeviceDescription, DeviceModel, Floats]:
    """The device in its sense, the model without laws, and the path of the loop coordinate through all recordings."""
    dynamics, (low, high) = heat.dynamics, sorted(device.operating_range)
    ends = (high, low) if dynamics.falling else (low, high)
    if ends != device.operating_range:
        device = device.running(ends)
    inside: dict[str, dict[str, float | str]] = {}
    if dynamics.relaxation:
        inside["transition_kinetics"] = {"time_constant": float(dynamics.relaxation)}
    if dynamics.frequency:
        inside["cantilever_resonance"] = {
            "share": 1.0, "frequency": dynamics.frequency, "damping": dynamics.damping,
        }  # fmt: skip
    if dynamics.behind:
        (role,) = (role for role in SECTIONS if role in device.channels)
        inside[f"sensor_lag:{role}"] = {"time_constant": dynamics.behind, "signal": role}
    model = DeviceModel(device.key, scalars=heat_scalars(heat, device), effects=inside)
    path = heat_path(grids, device, heat)[0] if model.heats else film_path(model, grids, True)
    return device, model, path


def _by_the_law(
    grids: Sequence[GriddedRecording],
    device: DeviceDescription,
    values: Mapping[str, Floats],
    found: RigDynamics,
) -> RigDynamics:
    """Which of these and those near them a Preisach law predicts held-out parts with best."""
    drives = [grid.current for grid in grids]

    def score(dynamics: RigDynamics) -> float:
        path = loop_path(grids, device, dynamics)
        folds = {role: folds_of_recordings(drives, fold_of(np.isfinite(y))) for role, y in values.items()}
        return sum(float(np.log(choose_preisach(path, y, folds[role]).misfit)) for role, y in values.items())

    return min((found, *found.near), key=score) if found.near and not found.slow_share else found


def _with_laws(model: DeviceModel, laws: Mapping[str, Law]) -> DeviceModel:
    return replace(
        model,
        resistance=laws.get("resistance", PlayBank()),
        deflection=laws.get("deflection", PlayBank()),
    )


def _run_freely(
    model: DeviceModel,
    grids: Sequence[GriddedRecording],
    role: str,
    values: Floats,
    fit: LoopLaw,
    heat: RigHeat,
) -> LoopLaw:
    """The fit with what a free run leaves: its misfit is that of the worst recording.

    The error of a run that heats itself is the run's, not a sample's: of few runs the worst one bounds the next. Where a
    part was left out between others its error counts, else that of the whole fit.
    """
    left = values - free_run(model, grids, role)
    ends = np.cumsum([0, *(grid.current.size + 1 for grid in grids)])
    pieces = [left[a:b] for a, b in itertools.pairwise(ends)]
    worst = max(float(np.sqrt(np.nanmean(piece**2))) for piece in pieces if np.isfinite(piece).any())
    misfit = max(worst, fit.misfit, *(heat.errors[heat.between] if role == RESISTANCE else ()))
    return replace(fit, residual=left, misfit=float(misfit))


def _along(grids: Sequence[GriddedRecording], role: str) -> Floats:
    """Measured values along the path, one missing before each recording."""
    parts = []
    for grid in grids:
        parts += [np.array([np.nan]), grid.measured.get(role, np.full(grid.current.size, np.nan))]
    return np.concatenate(parts)


def _loop(
    path: Floats,
    values: Floats,
    degree: int,
    fold: NDArray[np.int64],
    law: str,
    late: Late | None,
    count: int,
) -> LoopLaw:
    """Return the law that was asked for, with so many plays if it has them, or the one that predicts held-out parts best."""
    if law and law not in (PLAYS, AUTO):
        if late is None:
            return fit_loop_law(law, path, values, fold, count)
        return _before(late, _plays(path, values, degree, fold, late), law, path, values, fold, count)
    plays = _plays(path, values, degree, fold, late)
    alone = late is not None and not late.whole
    names = () if law == PLAYS or alone else tuple(FITTED) if law == AUTO else ("preisach", "bounded_plays")
    others = [_before(late, plays, name, path, values, fold, count) for name in names]
    return better_of(plays, others)


def _before(
    late: Late | None,
    known: LoopLaw,
    name: str,
    path: Floats,
    values: Floats,
    fold: NDArray[np.int64],
    count: int,
) -> LoopLaw:
    """A law of this name in front of what rings.

    What it is fitted to, D = y + (D - H D), takes what the mode H changes from a law D that is known already.
    """
    if late is None:
        return fit_loop_law(name, path, values, fold, count)
    fit = known
    for _ in range(_ROUNDS):
        before = fit.law.run(path, fit.law.initial_memory())
        after = late.through(before[:, None])[:, 0]
        fit = fit_loop_law(name, path, values + before - after, fold, count)
    before = fit.law.run(path, fit.law.initial_memory())
    return replace(fit, residual=values - late.through(before[:, None])[:, 0])


def _plays(path: Floats, values: Floats, degree: int, fold: NDArray[np.int64], late: Late | None) -> LoopLaw:
    """Return the bank of plays that predicts held-out parts best."""
    inside = path[path > path.min()]
    dictionaries = [PlayDictionary.over(float(inside.min()), float(inside.max()), **grid) for grid in _GRIDS]
    fits = [
        fit_dictionary(dictionary, path, values, degree=degree, fold=fold, late=late)
        for dictionary in dictionaries
    ]
    convex = min(fits, key=lambda one: one.misfit)
    count = int(np.count_nonzero(np.isfinite(values)))
    # one part tells enough of a long recording; of a short one all are needed
    parts = np.unique(fold[fold >= 0]).tolist()
    judged = parts if count < _SHORT or len(parts) < FOLDS else parts[-1:]
    seen = np.isin(fold, judged) & np.isfinite(convex.held_out)
    reference = least = float(np.sqrt(np.mean(convex.held_out[seen] ** 2)))
    chosen, held_out = None, convex.held_out
    for plays in _REFINED if count <= _LONGEST else ():
        start = convex.shape(plays, degree=3)
        if 0.7 * count < 2 * start.vector.size:
            continue
        gaps = np.full(values.size, np.nan)
        for part in judged:
            moved = fit_bank(
                path, np.where(fold == part, np.nan, values), start, iterations=_STEPS, late=late
            )
            mine = (fold == part) & seen
            gaps[mine] = moved.residual_of(path, values, late)[mine]
        error = root_mean_square(gaps)
        if error < MARGIN * least:
            least, chosen, held_out = error, start, gaps
    misfit = convex.misfit * least / reference
    if chosen is not None:
        fit = fit_bank(path, values, chosen, iterations=_STEPS, late=late)
        words = f"{chosen.centre.size} plays, moved, and a polynomial of degree 3"
    else:
        shape = convex.shape(degree=degree)
        output, jacobian = evaluate(shape, path, late)
        fit = BankFit(shape, values - output, jacobian, 0)
        words = f"{shape.centre.size} plays on a grid and a polynomial of degree {degree}"
    return LoopLaw(fit.shape.bank(), misfit, fit.residual, words, bank_uncertainty(fit), held_out)
