"""Second stage: what neither noise nor nuisance parameters explain, and where it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.adequacy import over_misfit
from vo2_models.diagnosis.breakdown import Breakdown, breakdown
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.loop_shape import loop_shapes, open_shapes
from vo2_models.diagnosis.misfit import NO_MISFIT
from vo2_models.diagnosis.moved_alone import nearest_constant
from vo2_models.diagnosis.noise import fit_noise
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.problem import LinearisedProblem, linearise_problem
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.read import Reading
from vo2_models.recording import HEATER_CURRENT

__all__ = ["Located", "locate"]

Floats = NDArray[np.float64]
SETTLED, SETTLED_BESIDE = 0.002, 0.02
"""Relative drop of chi-square with which moving the constants further ends: by themselves, and beside a large effect."""
STAYS = 0.7
"""Step, in units of what the simulation is linear over, below which constants stay."""
SLOW, FURTHER = 3, 0.25
"""Steps from which the way as a whole is gone further, and by which share of it."""


@dataclass(frozen=True)
class Located:
    """The problem without effects, and where its excess is.

    Attributes
    ----------
    nominal : fitted simulation, its noise that of the recordings where they show it
    problem : linearised about the nominal simulation, or about where its nuisance parameters are best
    remaining : (N,) whitened residual after the nuisance model
    excess : channel -> excess power over noise power, nuisance parameters refitted
    total_excess : the same of all channels
    breakdown : where the excess is
    left_out : excess power, in noise powers, of the stretch of the calibration that the others predict worst
    own_misfit : channel -> r.m.s. distance from the model over the error that the fit made on parts of its calibration
        that it was not given; empty where that is not known
    """

    nominal: Nominal
    problem: LinearisedProblem
    remaining: Floats
    excess: Mapping[str, float]
    total_excess: float
    breakdown: tuple[Breakdown, ...]
    left_out: float = 0.0
    own_misfit: Mapping[str, float] = field(default_factory=dict)

    def is_large(self, limits: Limits) -> bool:
        """Whether the excess of all channels, or of one, is more than unchanged devices of the own simulator show."""
        return self.total_excess > limits.excess or max(self.excess.values()) > limits.channel_excess

    def is_loud(self, limits: Limits) -> bool:
        """Whether it is large beyond what the calibration leads to expect, by its misfit and its worst stretch."""
        return (
            self.is_large(limits)
            and self.total_excess > self.left_out
            and (not self.within_misfit(limits.unlike_misfit) or self.total_excess > limits.far_beyond)
        )

    def within_misfit(self, limit: float) -> bool:
        """Whether no channel is further from the model than `limit` times what its calibration's held-out parts are."""
        return bool(self.own_misfit) and max(self.own_misfit.values()) < limit


def locate(reading: Reading, limits: Limits, clock: Clock, *, about: Floats | None = None) -> Located:
    """Build the problem, refit its nuisance parameters, and split what is left along every axis; return all of it.

    Where a law misses steep places by more than flat ones, and the recording is not far beyond that, a sample is judged by what
    its place is missed by. A large effect may move what is steep, so that beside it noise of one size stands.

    Parameters
    ----------
    reading : of the recordings
    limits : of the decisions
    clock : told what is being done
    about : (t,) moves of the constants to begin at, in their spreads; none by default
    """
    even = replace(reading, parts=tuple(replace(part, uneven={}) for part in reading.parts))
    located = _locate(even, limits, clock, about)
    if not any(part.uneven for part in reading.parts) or not located.within_misfit(limits.unlike_misfit):
        return located
    nominal = reading.nominal.with_uneven_noise()
    shapes = open_shapes(nominal) if reading.first_use else loop_shapes(nominal)
    return _locate(replace(reading, nominal=nominal, shapes=shapes), limits, clock, about)


def _locate(reading: Reading, limits: Limits, clock: Clock, about: Floats | None) -> Located:
    """As `locate`, with the noise that the reading has."""
    nominal = reading.nominal
    problem = linearise_problem(
        nominal,
        reading.parts,
        constants=reading.constants,
        shift=about,
        shapes=reading.shapes,
        refits=reading.first_use,
        say=clock.say,
    )
    problem = _relinearise_constants(nominal, problem, limits, clock)
    problem = _about_one_constant(nominal, problem, limits, clock)
    nominal, problem = _refine_noise_model(nominal, problem, reading, limits, clock)
    problem = _relinearise_constants(nominal, problem, limits, clock)
    remaining = problem.apply_inverse_covariance(problem.residual)
    excess, total = _excess(problem, remaining, problem.residual_chi_square)
    return Located(
        nominal,
        problem,
        remaining,
        excess,
        total,
        tuple(breakdown(problem, remaining)),
        _left_out(problem),
        over_misfit(problem, problem.residual),
    )


def _left_out(problem: LinearisedProblem) -> float:
    """Excess power that the calibration's worst stretch leads to expect of these recordings, all channels together."""
    expected = sum(
        problem.shapes[c].left_out * n for c, n in problem.count_by_channel.items() if c in problem.shapes
    )
    return expected / max(problem.count, 1)


def _relinearise_constants(
    nominal: Nominal, problem: LinearisedProblem, limits: Limits, clock: Clock, *, rounds: int = 16
) -> LinearisedProblem:
    """Move to where the nuisance model's own refit puts the thermal parameters, until they stay: it is not linear in them.

    Loops that are open along a wrong path of temperature take up a part of a move, so that plain steps come near slowly: each is
    extrapolated from the one before (Anderson's acceleration of depth one), and after many small ones the whole way is gone
    further as long as chi-square falls. Beside a large effect constants would only follow it further: there steps stay plain.
    """
    start = problem

    def beside() -> bool:
        return problem.residual_chi_square > limits.beside * problem.count

    def about(shift: Floats) -> LinearisedProblem:
        # columns of the start: those of a step before would be kept while the path is still near it
        return linearise_problem(
            nominal,
            start.parts,
            constants=start.constants,
            shift=shift,
            shapes=start.shapes,
            loops=problem.loops if beside() else start.loops,
            refits=start.refits,
            say=clock.say,
        )

    # without body, a number that the calibration has told is not wrong by many of its deviations: such a move is an effect's.
    # With one, constants share their moves with those of another day, and steps of which a part is missing lead nowhere
    shared = start.refits or nominal.model.description.has_body
    most = np.array([np.inf if c.drifts or shared else limits.mistaken for c in start.constants])
    targets: list[Floats] = []
    before: Floats | None = None
    for _ in range(rounds):
        target = np.clip(problem.fit_nuisance(problem.residual)[-problem.origin.size :], -most, most)
        step = target - problem.origin
        if problem.curved(step) < STAYS:
            break
        trials = [target] if beside() else [target, problem.origin + 0.5 * step]
        if before is not None and not beside():
            change = problem.in_straights(step - before)
            along = float(change @ problem.in_straights(step)) / max(float(change @ change), 1e-300)
            trials.insert(0, target - along * (target - targets[-1]))
        for trial in trials:
            moved = about(trial)
            drop = problem.residual_chi_square - moved.residual_chi_square
            if drop > -limits.unchanged:
                break
        if drop <= limits.unchanged:
            break
        targets.append(target)
        before, problem = step, moved
        if drop < (SETTLED_BESIDE if beside() else SETTLED) * moved.residual_chi_square:
            break
    while len(targets) >= SLOW and not beside():
        moved = about(problem.origin + FURTHER * (problem.origin - targets[0]))
        if problem.residual_chi_square - moved.residual_chi_square <= limits.unchanged:
            break
        problem = moved
    return problem


def _about_one_constant(
    nominal: Nominal, problem: LinearisedProblem, limits: Limits, clock: Clock
) -> LinearisedProblem:
    """Move to the one constant that brings the simulation nearest, if the refit from there leaves next to nothing.

    A room that is 4 K warmer is too far for linear steps beside loops that may change a little: what they leave would be taken
    for an effect, a laser that heats all the time for one.
    """
    left = problem.residual_chi_square / problem.count
    far = left > limits.beside or (left > 1.0 + limits.slack and problem.curved(problem.origin) > limits.went)
    if problem.refits or not far or not nominal.model.description.has_body:
        return problem
    clock.say("moving constants one by one")
    shift, share = nearest_constant(problem)
    if share > limits.better:
        return problem
    there = linearise_problem(
        nominal,
        problem.parts,
        constants=problem.constants,
        shift=shift,
        shapes=problem.shapes,
        say=clock.say,
    )
    there = _relinearise_constants(nominal, there, limits, clock)
    # where much is left it is an effect, beside which a constant would stand for a part of it
    most = min(limits.beside, 1.0 + limits.better * (left - 1.0))
    return there if there.residual_chi_square < most * there.count else problem


def _refine_noise_model(
    nominal: Nominal, problem: LinearisedProblem, reading: Reading, limits: Limits, clock: Clock
) -> tuple[Nominal, LinearisedProblem]:
    """Take level and colour of a channel's noise from the recording itself where little but noise is left in it.

    A calibration is slow and its noise may have another colour; where an effect is in the channel its residual is
    no noise, and the calibration's stands.
    """
    remaining = problem.apply_inverse_covariance(problem.residual)
    # a weight stands for misfit that is expected: what there is of it must not pass for a low noise
    left = remaining / np.where(problem.weight > 0, problem.weight, 1.0)
    before = nominal.noise
    noise = dict(before)
    parts = problem.parts
    for channel in dict.fromkeys(row.channel for row in problem.rows):
        rows = [row for row in problem.rows if row.channel == channel]
        if any(problem.misfit_in(row) for row in rows):
            continue  # the rest of a misfit is no noise
        power = [float(np.mean(left[row.where][problem.weight[row.where] > 0] ** 2)) for row in rows]
        if not all(limits.quiet_from < p < limits.quiet for p in power):
            continue
        if (
            channel == HEATER_CURRENT
        ):  # a reading that follows the command to its noise is of the same moments
            parts = tuple(replace(part, read_late=False) for part in problem.parts)
        known = noise[channel]
        plain = [
            problem.in_its_unit(row, remaining) / problem.parts[row.part].uneven.get(channel, 1.0)
            for row in rows
        ]
        found = fit_noise(
            np.concatenate(plain), np.concatenate([problem.weight[row.where] > 0 for row in rows])
        )
        if limits.noise_least < found.level / known.level < limits.noise_most:
            noise[channel] = found
    if noise == dict(nominal.noise) and parts is problem.parts:
        return nominal, problem
    nominal = replace(nominal, noise=noise)
    posterior = reading.shapes if reading.first_use else loop_shapes(nominal, problem.shapes)
    # what a weight stands for is in the noise already where that was found in the recording
    shapes = {
        channel: shape
        if noise.get(channel) is before.get(channel)
        else replace(shape, rough=0.0, misfit=NO_MISFIT)
        for channel, shape in posterior.items()
    }
    return nominal, linearise_problem(
        nominal,
        parts,
        constants=problem.constants,
        shift=problem.origin,
        shapes=shapes,
        loops=problem.loops,
        refits=problem.refits,
        say=clock.say,
    )


def _excess(
    problem: LinearisedProblem, remaining: Floats, chi_square: float
) -> tuple[dict[str, float], float]:
    """Excess power over noise power, by channel and of all: each channel's part of chi-square over its samples.

    Of a device that is fitted anew, by what that leaves: what its large moves cost is nothing that a channel has too much.
    """
    energy = problem.energy_by_channel(remaining if problem.refits else problem.residual, remaining)
    count = problem.count_by_channel
    by_channel = {channel: each / max(count[channel], 1) - 1.0 for channel, each in energy.items()}
    return by_channel, chi_square / max(problem.count, 1) - 1.0
