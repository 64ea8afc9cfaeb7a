"""Whether an explanation is adequate: it surely acts, and leaves no more over than noise and this device's own misfit.

A fitted law misses every device by something, and by how much is a matter of the device: a loop that is no Preisach
operator leaves several noise powers where another leaves none. Two figures tell a misfit that looks like an effect from the
effect. A misfit has the pattern in some stretches of a recording and not in others, so that the stretches do not agree on it;
and it is not used up by one effect, so that more than the device's own misfit is left.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.pairs import Option, trace
from vo2_models.diagnosis.problem import LinearisedProblem, at_sensor
from vo2_models.diagnosis.propagate_correction import as_sensed
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = [
    "Adequacy",
    "adequacy_of",
    "behind_the_loop",
    "ends_flat",
    "farthest_over_misfit",
    "over_misfit",
    "reached",
    "shown",
    "sureness",
    "where_told",
]

Floats = NDArray[np.float64]
QUARTILE = 0.6745
"""Median of the size of a normal deviate."""
CONCENTRATED = 4
"""Rounds in which the samples that are told are chosen; the choice hardly changes after two."""


@dataclass(frozen=True)
class Adequacy:
    """What an explanation takes away, and what it leaves.

    Attributes
    ----------
    keys : of the effects that it has
    share : of the excess that is explained, 0 to 1
    left : excess power that is left in the channels that its effects reach, in noise powers of a sample, beyond what an equation
        a little off leaves of its own: what another channel shows, they cannot explain
    sigmas : how surely its effects act, see `sureness`; infinite where the values themselves show one
    told : share of the samples that this is judged by
    elsewhere : largest excess power that is left in a channel that its effects do not reach
    """

    keys: tuple[str, ...]
    share: float
    left: float
    sigmas: float
    told: float = 1.0
    elsewhere: float = 0.0

    def something_else(self, limits: Limits) -> float:
        """Return the probability that it is none of these effects.

        Parameters
        ----------
        limits : with the coefficients
        """
        return limits.probability_of_something_else(self.sigmas, self.left)


def adequacy_of(option: Option, limits: Limits, *, most: float = np.inf) -> Adequacy:
    """Judge how surely an option acts and what it leaves over.

    Parameters
    ----------
    option : the explanation with the problem about it
    limits : with what an equation leaves
    most : gain in chi-square of which a share may be left: in the place of moved constants, what it gains over them

    Returns
    -------
    both, with the share of the excess that is explained
    """
    chosen, count, remaining = option.chosen, option.final.count, max(option.remaining, 0.0)
    gain = max(chosen.gain, 0.0)
    share = gain / max(gain + count * remaining, 1e-300)
    residual, inside = option.final.residual - chosen.deviation, reached(option)
    beside, others = _left_in(option.final, _before_the_structure(option, residual), inside)
    outside = set(option.final.count_by_channel) - inside
    elsewhere = max((_left_in(option.final, residual, {channel})[0] for channel in outside), default=0.0)
    left = max(beside - limits.equation * min(gain, most) / others, 0.0)
    # what this device's law misses of its own calibration is no sign of something else
    beyond, judged = _beyond_misfit(option, limits)
    told = judged.final.count / option.final.count
    sigmas = sureness(judged)
    return Adequacy(chosen.keys, share, left * max(beyond, default=1.0), sigmas, told, elsewhere)


def reached(option: Option) -> set[str]:
    """Return the channels in which an explanation does more than nothing.

    Parameters
    ----------
    option : with the problem about it
    """
    acting = trace(option.final)
    device = option.final.nominal.device
    known = {
        channel for one in option.chosen.hypotheses for channel in one.record.reaches(device, one.signal)
    }
    # what is simulated between the samples differs a little everywhere
    return {
        row.channel
        for row in option.final.rows
        if row.channel in known and float(np.sum(acting[row.where] ** 2)) > 1.0
    }


def ends_flat(option: Option, limits: Limits) -> bool:
    """Return whether a channel that an explanation cuts off is flat there but for its noise; True where it cuts none off.

    Beyond a limit nothing of the loops is left, nor their misfit: where the values go on, the law misses the end of its range.

    Parameters
    ----------
    option : the explanation with the problem about it
    limits : with how much more than noise may be left
    """
    problem = option.final
    for hypothesis, values in zip(option.chosen.hypotheses, option.chosen.values, strict=True):
        walls = [name for name in hypothesis.walls if name in values]
        for (row, part, response), name in product(problem.iterate(), walls):
            if row.channel != hypothesis.signal:
                continue
            above = float(hypothesis.parameter(name).default) > 0.0  # type: ignore[arg-type]
            end = np.log10(values[name]) if row.channel == RESISTANCE else values[name]
            simulated, noise = response.channels[row.channel], problem.nominal.noise[row.channel].level
            # the problem is about the fit before the last step: as near to the end as noise
            at_end = simulated > end - noise if above else simulated < end + noise
            beyond = at_end & (problem.weight[row.where] > 0)
            off = (part.observed[row.channel] - end)[beyond]
            if off.size >= limits.flat_samples:
                # noise that has grown since the calibration goes up and down from sample to sample, misfit does not
                by_steps = float(np.median(np.abs(np.diff(off)))) / np.sqrt(2.0)
                if np.median(np.abs(off)) > limits.flat * max(QUARTILE * noise, by_steps):
                    return False
    return True


def _left_in(problem: LinearisedProblem, residual: Floats, channels: set[str]) -> tuple[float, int]:
    """Excess power over noise power that is left of a residual (N,) in some channels, and their samples that count."""
    energy = problem.energy_by_channel(residual, problem.apply_inverse_covariance(residual))
    count = max(sum(problem.count_by_channel[channel] for channel in channels), 1)
    return sum(energy[channel] for channel in channels) / count - 1.0, count


def over_misfit(problem: LinearisedProblem, residual: Floats) -> dict[str, float]:
    """Return how far each channel of a device without body is from the model, over the error on held-out calibration.

    Constants are moved: where they stand is told by itself.

    Parameters
    ----------
    problem : the problem
    residual : (N,) what is left, scaled as `problem.residual`

    Returns
    -------
    channel -> r.m.s. distance over r.m.s. error; empty where that error is not known
    """
    return {channel: _rms(values) for channel, values in _in_misfits(problem, residual).items()}


def _before_the_structure(option: Option, residual: Floats) -> Floats:
    """Return a residual (N,) whose deflection is divided by what the explanation's structure enlarges it by, at each frequency.

    A mode rings to what the law misses as it does to the rest: near its frequency it enlarges the device's own misfit by up to
    its quality, which is no sign of something else. With H the response of the structure to a change of the deflection, with the
    explanation over without it, the residual's spectrum is divided by |H| where that is above 1.
    """
    if not any(hypothesis.record.stage == "structure" for hypothesis in option.chosen.hypotheses):
        return residual
    final, out = option.final, residual.copy()
    without = final.nominal.model.simulation
    for row, part, _ in final.iterate():
        if row.channel != TIP_DEFLECTION:
            continue
        size = 2 * part.size
        impulse = np.zeros((part.size, 1))
        impulse[1] = 1.0
        enlarged, plain = (
            np.abs(np.fft.rfft(as_sensed(simulation, row.channel, impulse, part.dt)[:, 0], size))
            for simulation in (without.with_effects(final.included), without)
        )
        spectrum = np.fft.rfft(out[row.where], size) / np.maximum(enlarged / np.maximum(plain, 1e-12), 1.0)
        out[row.where] = np.fft.irfft(spectrum, size)[: part.size]
    return out


def farthest_over_misfit(option: Option) -> float:
    """Return the largest of `over_misfit` that an explanation leaves, 0 where that error is not known.

    Parameters
    ----------
    option : the explanation with the problem about it
    """
    left = over_misfit(option.final, option.final.residual - option.chosen.deviation)
    return max(left.values(), default=0.0)


def behind_the_loop(problem: LinearisedProblem, gain: float) -> float:
    """Return what of a gain in chi-square may lie in channels behind the loop.

    What the logged drive and a thermometer show, they show on one loop as well as on many.

    Parameters
    ----------
    problem : without effects
    gain : of an explanation
    """
    energy = problem.energy_by_channel(problem.residual, problem.apply_inverse_covariance(problem.residual))
    return max(gain - sum(max(energy.get(c, 0.0), 0.0) for c in (HEATER_CURRENT, STAGE_TEMPERATURE)), 0.0)


def where_told(problem: LinearisedProblem, residual: Floats, share: float) -> NDArray[np.bool_]:
    """Return the samples (N,) that a residual leaves nearest to the model: of each channel a share of those that count.

    A law misses some places by far more than others, small loops that are none of its kind; constants that are moved for
    them are wrong elsewhere. They are moved for the samples that are kept, and these are chosen anew, as in least trimmed
    squares: Rousseeuw and Van Driessen, Data Min. Knowl. Discov. 12, 29, 2006.

    Parameters
    ----------
    problem : the problem
    residual : (N,) what is left, scaled as `problem.residual`
    share : of the samples, 0 to 1
    """
    kept = problem.weight > 0
    for _ in range(CONCENTRATED):
        left = problem.weight > 0
        for channel, values in _in_misfits(problem, residual, kept).items():
            rows = problem.rows_of(channel)
            places = rows.start + np.flatnonzero(left[rows])
            left[places[np.argsort(np.abs(values))[int(share * places.size) :]]] = False
        kept = left
    return kept


def _beyond_misfit(option: Option, limits: Limits) -> tuple[list[float], Option]:
    """Share of what is left of each channel of a device without body that is beyond twice its error on held-out calibration.

    And the option with the samples that are judged. Where the effects bring the samples that they explain best, most of all,
    from beyond the misfit to within it, these are judged: the rest is the law's.
    """
    final = option.final
    after = final.residual - option.chosen.deviation
    found = list(over_misfit(final, after).values())
    if not found or max(found) <= limits.own_misfit:
        return [0.0 for _ in found], option
    kept = where_told(final, after, limits.told)
    among = {c: kept[final.rows_of(c)][final.weight[final.rows_of(c)] > 0] for c in _in_misfits(final, after)}
    end = norm.ppf(0.5 + 0.5 * limits.told)
    normal = np.sqrt(1.0 - 2.0 * end * norm.pdf(end) / limits.told)  # of the same share of normal numbers
    told, without = (
        [_rms(values[among[channel]]) for channel, values in _in_misfits(final, residual, kept).items()]
        for residual in (after, after + trace(final))
    )
    explained = [
        before > limits.own_misfit * max(there / normal, 1.0)
        for there, before in zip(told, without, strict=True)
    ]
    judged = [
        min(there / normal, whole) if more else whole
        for there, more, whole in zip(told, explained, found, strict=True)
    ]
    beyond = [
        max(each**2 - limits.own_misfit**2, 0.0) / max(whole**2, 1e-12)
        for each, whole in zip(judged, found, strict=True)
    ]
    return beyond, replace(option, final=final.restricted(kept)) if all(explained) else option


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _in_misfits(
    problem: LinearisedProblem, residual: Floats, kept: NDArray[np.bool_] | None = None
) -> dict[str, Floats]:
    """Channel -> residual (n,) of the samples that count over the r.m.s. error on held-out calibration.

    Constants are moved: for all samples, or for those of `kept` (N,).
    """
    model = problem.nominal.model
    if model.description.has_body:
        return {}
    whole, fitted = problem, residual
    if kept is not None:
        problem, fitted = problem.restricted(kept), np.where(kept, residual, 0.0)
    weights = problem.fit_nuisance(fitted)[-len(problem.constants) :]
    drifting = np.array([constant.drifts for constant in problem.constants])
    residual = residual - whole.nuisance.thermal @ np.where(drifting, weights, 0.0)
    found = {}
    for channel in dict.fromkeys(row.channel for row in whole.rows):
        sensor = model.sensors.get(channel)
        if sensor is None or not sensor.misfit > 0.0:
            continue
        rows = [row for row in whole.rows if row.channel == channel]
        values = [whole.in_its_unit(row, residual)[whole.weight[row.where] > 0] for row in rows]
        found[channel] = np.concatenate(values) / (sensor.misfit * shown(whole, channel))
    return found


def shown(problem: LinearisedProblem, channel: str) -> float:
    """Return how far a sensor shows a small misfit of a channel enlarged, r.m.s.: a ripple's slope; at least 1.

    Parameters
    ----------
    problem : about its effects
    channel : judged
    """
    slopes = [
        as_sensed(
            problem.nominal.model.simulation.with_effects(problem.included),
            channel,
            np.ones((part.size, 1)),
            part.dt,
            film,
        )
        for row, part, _ in problem.iterate()
        if row.channel == channel
        and (film := at_sensor(problem.nominal, channel, part, problem.included)) is not None
    ]
    return max(float(np.sqrt(np.mean(np.concatenate(slopes) ** 2))), 1.0) if slopes else 1.0


def sureness(option: Option) -> float:
    """Return how surely the stretches of the recordings say together that each effect acts, in standard deviations.

    With x what an effect changes beside the others and e what is left, the nuisance model taken out of both, its gain is
    x'x + 2 x'e, or less where the nuisance model has paid for moving along. In noise x'e scatters by the root of x'x, which
    makes the root of the gain the certainty. Misfit goes on over many samples: the sum of x'e over a long stretch counts once,
    as in White's covariance for clusters, and S^2, the sum of their squares, may be larger. The certainty is the root of
    gain x'x / S^2. What a misfit has of a pattern, it has in some stretches and not in others.
    Cameron and Miller, J. Hum. Resour. 50, 317, 2015.

    Parameters
    ----------
    option : with the problem about it

    Returns
    -------
    of the least sure effect
    """
    final = option.final
    left = final.apply_inverse_covariance(final.residual - option.chosen.deviation)
    straight = replace(final, nuisance=replace(final.nuisance, courses=None))

    def one(key: str) -> float:
        acting = trace(final, key)
        x = straight.apply_inverse_covariance(acting)
        own = max(float(x @ acting), 1e-12)
        wider = max(float(np.sum(final.over_stretches(x * left) ** 2)) / own, 1.0)
        gain = min(own + 2.0 * float(x @ left), option.chosen.gain)
        return float(np.sqrt(max(gain, 0.0) / wider))

    return min(one(key) for key in option.chosen.keys)
