"""First stage: recordings made ready for comparison, with what limits an answer."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from vo2_models.diagnosis.breakdown import one_loop
from vo2_models.diagnosis.check import Finding, Unusable, check_recording
from vo2_models.diagnosis.consistency import check_consistency
from vo2_models.diagnosis.drift import Drift
from vo2_models.diagnosis.evident import Evident, evident_effects, untold_steps, without_lines
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.loop_shape import LoopShape, loop_shapes, open_shapes
from vo2_models.diagnosis.noise import outliers
from vo2_models.diagnosis.nominal import Nominal, Response, loop_ends
from vo2_models.diagnosis.nuisance import (
    Constant,
    Coverage,
    constants_of,
    constants_of_each,
    coverage,
    coverage_of,
    from_beyond,
    refitted_constants,
)
from vo2_models.diagnosis.part import Part, prepare
from vo2_models.diagnosis.progress import Clock
from vo2_models.identification.rig_start import unknown_until
from vo2_models.identification.steepness import unevenness
from vo2_models.recording import HEATER_CURRENT, Recording, aligned
from vo2_models.units import stamp_in_words

__all__ = ["Reading", "read"]

Floats = NDArray[np.float64]
STEP = 0.1
"""Step of a delay around its best, in sample periods."""
MEMORY, BYTES_A_SAMPLE = 0.6, 45_000.0
"""Share of the machine's memory that a diagnosis may take, and what it was seen to take for a sample of 20 000 to 200 000."""
EARLIEST = -3.0
"""Earliest answer before its command that is looked for, in sample periods."""
ONE_LOOP = Finding(
    "one loop",
    "the film went over one and the same loop only, on which many effects look alike, and may look like another loop: "
    "steps, smaller loops and other rates would tell more",
)


@dataclass(frozen=True)
class Reading:
    """Recordings ready for comparison.

    Attributes
    ----------
    nominal : fitted simulation
    shapes : channel -> posterior of its loop shape
    parts : recordings in judged units, with the samples that count
    findings : limits of the data
    one_loop : whether the film went over one loop only, on which many effects look alike
    constants : that a refit may move
    calibrations : number of the first parts that are calibrations, 0 where the model file stands for them
    evident : effects that the values show by themselves and the simulation lacks
    """

    nominal: Nominal
    shapes: Mapping[str, LoopShape]
    parts: tuple[Part, ...]
    findings: tuple[Finding, ...]
    one_loop: bool
    constants: tuple[Constant, ...]
    calibrations: int = 0
    evident: tuple[Evident, ...] = ()

    @property
    def first_use(self) -> bool:
        """Whether the effect may have been there all along, so that calibrations are among the recordings."""
        return self.calibrations > 0

    def with_moved(self, drift: Drift) -> tuple[Reading, Floats]:
        """Return the reading whose constants may have moved as far as they have, and these moves (t,) in their new spreads.

        Parameters
        ----------
        drift : moves of the constants
        """
        further = np.maximum(1.0, np.abs(drift.weights))
        constants = tuple(
            replace(c, spread=c.spread * float(f), straight=c.straight / float(f))
            for c, f in zip(self.constants, further, strict=True)
        )
        # where the law is steep along the simulation without these moves is not where it is with them
        parts = tuple(replace(part, uneven={}) for part in self.parts)
        return replace(self, constants=constants, parts=parts), drift.weights / further


def read(
    recordings: Sequence[Recording],
    nominal: Nominal,
    names: Sequence[str],
    limits: Limits,
    clock: Clock,
    *,
    calibrations: int = 0,
) -> Reading:
    """Check recordings, put them on regular grids, find how they began, and leave out what cannot be judged.

    Parameters
    ----------
    recordings : of one device
    nominal : fitted simulation
    names : of the recordings, for messages; empty for numbers
    limits : when a command counts as stamped at the other end of its interval
    clock : told what is being done
    calibrations : so many of the recordings, the first ones, are those that the model was fitted to: nominal device and
        effect are then fitted together

    Returns
    -------
    what the next stages need of the recordings, and what was found on the way

    Raises
    ------
    Unusable : data with which nothing can be said; one line with the reason.
    """
    clock.say("checking the data")
    if not recordings:
        raise Unusable("recording: found none, need at least one")
    if len(devices := list(dict.fromkeys(one.device for one in recordings if one.device))) > 1:
        raise Unusable(
            f"recordings: found recordings of the devices {' and '.join(devices)}, need those of one device"
        )
    findings: list[Finding] = []
    parts = []
    share = min(_most_samples() / sum(map(len, recordings)), 1.0)
    for number, raw in enumerate(recordings, 1):
        recording = aligned(raw, nominal.model.command_delay)
        name = names[number - 1] if names else f"recording {number}"
        if share < 1.0:
            recording = recording.slice(0, int(share * len(recording)))
            text = f"of {len(raw)} samples the first {len(recording)} are judged, as many as this machine's memory takes"
            more = "another stretch that begins at rest can be given as a recording of its own"
            findings.append(Finding("long", f"{name}: {text}; {more}"))
        found = check_recording(recording, nominal, limits, name=name)
        findings += found
        dead = {finding.leaves_out for finding in found}
        left = {c: values for c, values in recording.channels.items() if c not in dead}
        parts.append(prepare(replace(recording, channels=left), nominal, name=name))
    clock.say("simulating the recordings")
    shapes = open_shapes(nominal) if calibrations else loop_shapes(nominal)
    corrected = replace(nominal, corrections={c: s.fold() for c, s in shapes.items()})
    parts, stamps = _restamped(parts, corrected, limits)
    findings += stamps
    started = [_detect_initial_state(part, corrected, limits) for part in parts]
    started = [(_with_unevenness(part, response, nominal), response) for part, response in started]
    if not nominal.model.heats:
        started, unknown = _without_unknown_starts(started)
        findings += unknown
    started, alone = _without_outliers(started, limits)
    findings += alone
    check_consistency(started, nominal, calibrations, limits)
    evident = evident_effects(started, corrected, limits, first_use=calibrations > 0)
    started, lines, swinging = without_lines(started, corrected, limits, first_use=calibrations > 0)
    findings += [Finding("swings", text) for text in swinging]
    if not calibrations:
        findings += [Finding("steps", text) for text in untold_steps(parts, nominal, evident, limits)]
    parts, findings = _mask_after_gaps(started, nominal, findings, limits)
    paths = [response.temperature for _, response in started]
    covered = coverage_of(paths) if calibrations else coverage(nominal)
    parts, findings = _mask_uncovered(parts, paths, covered, tuple(shapes), findings, limits)
    if not calibrations:
        parts, findings = _mask_from_beyond(parts, paths, nominal, findings, limits)
    repeating = one_loop(paths, [part.dt for part in parts], limits)
    if repeating:
        findings = [*findings, ONE_LOOP]
    constants = refitted_constants(nominal) if calibrations else constants_of(nominal)
    each = constants_of_each(nominal, len(parts), calibrations)
    # those that a search holds come last, see `Constant.held`
    constants = (*(c for c in constants if not c.held), *each, *(c for c in constants if c.held))
    return Reading(
        nominal, shapes, tuple(parts), tuple(findings), repeating, constants, calibrations,
        (*evident, *lines),
    )  # fmt: skip


def _most_samples() -> int:
    """How many samples a diagnosis on this machine may take, over all recordings."""
    return int(MEMORY * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / BYTES_A_SAMPLE)


def _restamped(parts: Sequence[Part], nominal: Nominal, limits: Limits) -> tuple[list[Part], list[Finding]]:
    """Move commands that do not stand where they act, by what can only be their stamps.

    Where an answer comes before its command only the stamps can be wrong, by whatever that is. Where it comes one sample
    period late, and nothing between, that is a convention of the rig (a dead time of just that length is the alternative,
    and hardly one). Any other lateness is one, or a dead time: the recording cannot tell, and it is left to the search.
    """
    found, told = [], []
    for part in parts:
        misfit = {k: _misfit(part, nominal, k) for k in (-1.0, 0.0, 1.0)}
        best = min((-1.0, 1.0), key=lambda k: misfit[k])
        delay = 0.0
        if misfit[best] < limits.stamps * misfit[0.0] and _peaks_at(best, part, nominal, limits):
            delay = best
        elif best < 0.0 and misfit[best] < misfit[0.0]:
            plain = replace(nominal, corrections={})  # a tenth of the time, and as good for that
            early = minimize_scalar(
                lambda k, part=part, plain=plain: _misfit(part, plain, k),
                bounds=(EARLIEST, 0.0),
                method="bounded",
                options={"xatol": 1e-2, "maxiter": 12},
            )
            if (
                _misfit(part, nominal, float(early.x)) < limits.stamps * misfit[0.0]
                and early.x < -limits.whole_period
            ):
                delay = float(early.x)
        if delay:
            part = replace(part, current=_shifted(part.current, delay))
            where = {
                -1.0: "stamped at the end of the interval that they govern",
                1.0: "stamped at the start of the interval that they govern",
            }
            told.append(
                Finding(
                    "stamps",
                    f"{part.name}: commands act {abs(delay) * part.dt:.4g} s {'before' if delay < 0 else 'after'} where they "
                    f"stand: taken as {where.get(delay, 'stamped late')}, recording.command_delay "
                    f"{delay * part.dt:+.4g} s beside that of the model",
                )
            )
        found.append(part)
    return found, told


def _peaks_at(whole: float, part: Part, nominal: Nominal, limits: Limits) -> bool:
    """Whether the delay that fits best is a whole sample period, by the parabola through three misfits."""
    low, middle, high = (_misfit(part, nominal, whole + step) for step in (-STEP, 0.0, STEP))
    bend = low - 2.0 * middle + high
    off = 0.5 * STEP * (low - high)
    return bend > 0.0 and abs(off / bend) < limits.whole_period


def _misfit(part: Part, nominal: Nominal, delay: float) -> float:
    """Squared difference from the simulation over the noise, outliers held, with commands later by `delay` periods."""
    response = nominal.respond(_shifted(part.current, delay), part.dt, settled=part.settled)
    total = 0.0
    for channel in part.channels:
        gap = (part.observed[channel] - response.channels[channel])[part.valid[channel]]
        total += float(np.sum(np.minimum((gap / nominal.noise[channel].level) ** 2, 1e6)))
    return total


def _shifted(current: Floats, delay: float) -> Floats:
    """A held current (n,), each value the mean over its interval, later by `delay` sample periods."""
    whole = int(np.floor(delay))
    share = delay - whole
    place = np.arange(current.size) - whole
    first, second = (current[np.clip(p, 0, current.size - 1)] for p in (place, place - 1))
    return np.ascontiguousarray((1.0 - share) * first + share * second)


def _detect_initial_state(part: Part, nominal: Nominal, limits: Limits) -> tuple[Part, Response]:
    """Take a recording as begun at its first current where that fits its first samples far better than a cold start.

    A drive that heats nothing was somewhere before: where it is first, for all that is known.
    """
    if not nominal.model.heats:
        return replace(part, settled=True), nominal.respond(part.current, part.dt, settled=True)
    tau = nominal.model.scalars["thermal.time_constant"]
    first = int(np.clip(np.ceil(5 * tau / part.dt), 3, part.size // 10))
    cold, warm = (nominal.respond(part.current, part.dt, settled=settled) for settled in (False, True))
    misses = []
    for response in (cold, warm):
        miss = 0.0
        for channel in part.channels:
            noise = nominal.noise[channel].level
            gap, good = part.observed[channel] - response.channels[channel], part.valid[channel]
            # a constant that has moved goes on, a wrong start does not
            after = gap[first : 4 * first][good[first : 4 * first]]
            gap = gap[:first][good[:first]] - (np.median(after) if after.size else 0.0)
            miss += float(np.sum(np.minimum((gap / noise) ** 2, 1e6)))
        misses.append(miss)
    if misses[1] < limits.begun_at_rest * misses[0] - limits.begun_at_rest_by:
        return replace(part, settled=True), warm
    return part, cold


def _with_unevenness(part: Part, response: Response, nominal: Nominal) -> Part:
    """The part with the sizes of what the law misses along its response."""
    model = nominal.model
    known = {
        c: model.sensors[c] for c in part.channels if c in model.sensors and model.sensors[c].misfit_flat
    }
    return replace(
        part,
        uneven={
            c: unevenness(model.description, sensor, response.temperature, response.channels[c])
            for c, sensor in known.items()
        },
    )


def _without_unknown_starts(
    started: Sequence[tuple[Part, Response]],
) -> tuple[list[tuple[Part, Response]], list[Finding]]:
    """Leave out what comes before the drive has been at an end of its range, where the model is far further off than later."""
    found, told = [], []
    for part, response in started:
        valid = dict(part.valid)
        for channel in part.channels:
            simulated = response.channels[channel]
            gap = np.where(valid[channel], part.observed[channel] - simulated, np.nan)
            if unknown := unknown_until(gap, simulated, part.current):
                valid[channel] = valid[channel] & (np.arange(part.size) >= unknown)
                told.append(
                    Finding(
                        "start",
                        f"{part.name}: {channel} begins at a state that the drive does not show, relaxed or demagnetised for "
                        f"one: the first {unknown} samples, until the drive has been at an end of its range, are not judged",
                    )
                )
        found.append((replace(part, valid=valid), response))
    return found, told


def _without_outliers(
    started: Sequence[tuple[Part, Response]], limits: Limits
) -> tuple[list[tuple[Part, Response]], list[Finding]]:
    """Leave out single samples that are far from both of their neighbours, beside what the simulation says of all three.

    A current that is read back is none of these channels: late by a sample it stands alone at every step of the command.
    """
    found, told = [], []
    for part, response in started:
        valid = dict(part.valid)
        for channel in (c for c in part.channels if c != HEATER_CURRENT):
            gap = np.where(valid[channel], part.observed[channel] - response.channels[channel], np.nan)
            step = float(np.sqrt(12.0) * np.max(part.comb_level(channel)))
            dropped = _dropped(part, response, channel, limits)
            if np.any(dropped):
                valid[channel] = valid[channel] & ~dropped
                first = stamp_in_words(part.time_s[np.argmax(dropped)])
                told.append(
                    Finding(
                        "dropped",
                        f"{part.name}: {np.count_nonzero(dropped)} samples of {channel} stand at exactly 0, most of them far "
                        f"from the simulation, the first at {first}: a loose contact or a lost "
                        "reading, which are not judged",
                    )
                )
            alone = outliers(np.where(dropped, np.nan, gap), step, response.channels[channel])
            if np.any(alone):
                valid[channel] = valid[channel] & ~alone
                count = np.count_nonzero(alone)
                told.append(
                    Finding(
                        "outliers",
                        f"{part.name}: {count} sample{'s' if count > 1 else ''} of {channel} stand{'' if count > 1 else 's'} "
                        f"alone, the first at {stamp_in_words(part.time_s[np.argmax(alone)])}: outliers, which are not judged",
                    )
                )
        found.append((replace(part, valid=valid), response))
    return found, told


def _dropped(part: Part, response: Response, channel: str, limits: Limits) -> NDArray[np.bool_]:
    """Samples (n,) at which a channel jumps to exactly 0, where the simulation is far from it at most of them; else none.

    A range that ends at 0 is reached step by step.
    """
    course = response.channels[channel]
    # what lies at the end of a range is taken for a limit, and does not count already
    read = np.any(
        [part.valid[channel], *(one[channel] for one in part.flat.values() if channel in one)], axis=0
    )
    at_zero = read & (part.observed[channel] == 0.0)
    near = np.convolve(at_zero, np.ones(3), "same")
    beside = read & ~at_zero & (near > 0.0)
    least = limits.dropped * np.ptp(course)
    for off in (np.abs(course[at_zero]), np.abs(part.observed[channel][beside])):
        if not np.count_nonzero(off > least) > limits.dropped_most * off.size:
            return np.zeros_like(at_zero)
    return at_zero


def _mask_after_gaps(
    started: Sequence[tuple[Part, Response]], nominal: Nominal, findings: Sequence[Finding], limits: Limits
) -> tuple[list[Part], list[Finding]]:
    """Leave out what follows a long gap until the loops have forgotten it: until the film was outside of them."""
    low, high = loop_ends(nominal.model)
    parts, lost, count = [], 0, 0
    for part, response in started:
        known = np.ones(part.size, dtype=bool)
        outside = np.flatnonzero((response.temperature < low) | (response.temperature > high))
        settling = int(np.ceil(8 * nominal.model.scalars["thermal.time_constant"] / part.dt))
        for begin, end in part.blind:
            later = outside[outside >= end + settling]
            known[begin : int(later[0]) if later.size else part.size] = False
        parts.append(replace(part, valid={c: good & known for c, good in part.valid.items()}))
        lost, count = lost + int(np.count_nonzero(~known)), count + part.size
    if not lost:
        return parts, list(findings)
    if lost > limits.forgotten * count:
        raise Unusable(
            f"recordings: after gaps the state of the loops is unknown for {lost} of {count} samples; record without "
            "gaps, or give the pieces between them as recordings of their own"
        )
    forgotten = Finding(
        "forgotten",
        f"{100 * lost / count:.1f} % of the samples lie in or after long gaps, before the film left the loops: "
        "they are not judged",
    )
    return parts, [*findings, forgotten]


def _mask_uncovered(
    given: Sequence[Part],
    paths: Sequence[Floats],
    covered: Coverage,
    channels: Sequence[str],
    findings: Sequence[Finding],
    limits: Limits,
) -> tuple[list[Part], list[Finding]]:
    """Leave out of these channels what happens at temperatures (n,) [degC] that are not covered."""
    parts, beyond, count = [], 0, 0
    for part, path in zip(given, paths, strict=True):
        inside = covered.holds(path)
        beyond, count = beyond + int(np.count_nonzero(~inside)), count + part.size
        valid = {c: good & inside if c in channels else good for c, good in part.valid.items()}
        parts.append(replace(part, valid=valid))
    if not beyond:
        return parts, list(findings)
    if count - beyond < limits.shortest // 2:
        raise Unusable(
            f"recordings: {beyond} of {count} samples are outside of {covered}, which is what the calibration covers; "
            "fit a calibration that covers them"
        )
    uncovered = Finding(
        "unjudged" if beyond > limits.unjudged * count else "beyond",
        f"{100 * beyond / count:.1f} % of the samples are at temperatures outside of {covered}, "
        "which the calibration hardly covers: they are not judged",
    )
    return parts, [*findings, uncovered]


def _mask_from_beyond(
    given: Sequence[Part],
    paths: Sequence[Floats],
    nominal: Nominal,
    findings: Sequence[Finding],
    limits: Limits,
) -> tuple[list[Part], list[Finding]]:
    """Leave out, of a device without body, what its calibration's drive did not reach, and states that came from there."""
    digest, scalars = nominal.digest, nominal.model.scalars
    gain = scalars["thermal.linear_gain"]
    if digest is None or nominal.model.description.has_body or scalars["thermal.square_gain"] or not gain:
        return list(given), list(findings)
    # the way to and from a start is in no block with a sample
    reached = np.column_stack([digest.temperature[1:], digest.temperature[:-1]])[digest.count > 0.0]
    low, high = float(reached.min()), float(reached.max())
    masks = [from_beyond(path, low, high) for path in paths]
    beyond, count = sum(int(np.count_nonzero(m)) for m in masks), sum(part.size for part in given)
    if not beyond:
        return list(given), list(findings)
    ends = sorted((end - scalars["thermal.ambient"]) / gain for end in (low, high))
    covered = f"{ends[0]:.4g} to {ends[1]:.4g} {nominal.model.description.drive_unit}"
    if count - beyond < limits.shortest:
        raise Unusable(
            f"recordings: {beyond} of {count} samples are beyond {covered}, which is what the calibration covers, or come from "
            "there on loops that it has not seen; fit a calibration that covers them"
        )
    parts = [
        replace(part, valid={c: good & ~mask for c, good in part.valid.items()})
        for part, mask in zip(given, masks, strict=True)
    ]
    text = (
        f"{100 * beyond / count:.1f} % of the samples are beyond {covered}, which is what the calibration covers, or come from "
        "there on loops that it has not seen: they are not judged"
    )
    return parts, [*findings, Finding("unjudged" if beyond > limits.unjudged * count else "beyond", text)]
