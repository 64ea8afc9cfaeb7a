"""What to record next where two explanations cannot be told apart.

Every excitation of a library within the device's limits is simulated under both explanations. Their predicted
distance is what remains after the second has refitted its parameters and the nuisance model its loop shape and heat, in
standard deviations of the noise (T-optimal design of Atkinson and Fedorov). The largest wins; if even that
is too small, no excitation separates them and something has to be changed by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import preset, surrogate_of_temperature
from vo2_models.diagnosis.explain import A_STEP, Explanation
from vo2_models.diagnosis.hypotheses import Hypothesis
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.nonparametric_correction import Shape
from vo2_models.diagnosis.part import Part
from vo2_models.diagnosis.problem import LinearisedProblem, linearise_problem
from vo2_models.diagnosis.result import NextExperiment
from vo2_models.identification.excitation import chirp, first_order_reversal_fan, random_levels

__all__ = ["Excitable", "by_hand", "library", "propose", "to_cover", "without_explanation"]

Floats = NDArray[np.float64]
COVERING = "short steps of all sizes"
"""Excitation of the library that goes over the whole range, through loops of all sizes and at many rates."""
SAMPLES = 5000
"""Length of a proposed experiment."""
REPEAT = "play the same drive again, at another hour: what follows the clock or the room changes, what is the device's returns"
RATES = "play the same drive at half and at twice its speed: what follows the rate changes, what belongs to the loop stays"
LOOPS = "play small loops about several levels, each many times, and the whole loop in between: reversals and wear change them"
LEVELS = "go to a dozen levels from below and above and hold each: what belongs to a temperature is there while nothing moves"
TO_SEE = {
    "time": REPEAT, "tone": REPEAT, "felt temperature": REPEAT, "felt tone": REPEAT, "time and temperature": REPEAT,
    "time and value": REPEAT, "rate": RATES, "lagged drive": RATES, "current": RATES, "reversals": LOOPS,
    "travel": LOOPS, "branch": LOOPS, "value": LEVELS, "temperature": LEVELS,
}  # fmt: skip
"""What a correction without a name depends on -> what to record to see whether it does."""


@dataclass(frozen=True)
class Excitable:
    """A sequence of levels as `identifier` plays it."""

    name: str
    levels_a: Floats
    hold_s: float
    rate_a_per_s: float = 0.0

    def current(self, dt: float, cold: float) -> Floats:
        """Current of every sample (n,) [A], from the coldest operating current."""
        hold = max(1, round(self.hold_s / dt))
        pieces, last = [np.full(max(1, hold), cold)], cold
        for level in self.levels_a:
            if self.rate_a_per_s > 0:
                count = max(2, round(abs(level - last) / self.rate_a_per_s / dt) + 1)
                pieces.append(np.linspace(last, level, count)[1:])
            pieces.append(np.full(hold, level))
            last = float(level)
        return np.concatenate(pieces)

    def playable(self) -> dict[str, object]:
        """Parameters of `identifier`."""
        return {
            "kind": "levels",
            "levels_a": [float(f"{v:.7g}") for v in self.levels_a],
            "hold_s": float(self.hold_s),
            "rate_a_per_s": float(self.rate_a_per_s),
        }


def library(device: str, dt: float) -> list[Excitable]:
    """Return excitations within the operating range of a device, each of about `SAMPLES` samples.

    Parameters
    ----------
    device : preset or path of a device file
    dt : sample period [s]

    Raises
    ------
    ValueError : an operating range whose ends are equal.
    """
    nominal = preset(device)
    cold, hot = nominal.operating_range
    low, high = (nominal.steady_temperature(i) for i in (cold, hot))
    begin = nominal.heating[0] - nominal.width[0] - 2 * nominal.heating[1]
    end = nominal.heating[0] + 2 * nominal.heating[1]
    middle = 0.5 * (begin + end)
    tau = nominal.time_constant

    def at(temperature: float | Floats) -> Floats:
        return np.atleast_1d(surrogate_of_temperature(device, np.clip(temperature, low, high)))

    total = SAMPLES * dt
    span = abs(hot - cold)
    if not span > 0:
        raise ValueError(
            f"device {device}: found the operating range {cold} to {hot}, need two different ends"
        )
    found = []

    def ramps(name: str, temperatures: Floats, share: float = 0.9) -> None:
        levels = at(temperatures)
        travel = float(np.sum(np.abs(np.diff(levels, prepend=cold))))
        rate = travel / (share * total)
        found.append(Excitable(name, levels, max(dt, (1 - share) * total / levels.size), rate))

    ramps("two slow major loops", np.array([high, low, high, low]))
    ramps("forty fast major loops", np.tile([high, low], 40))
    ramps(
        "reversal fan",
        first_order_reversal_fan(np.r_[np.linspace(begin, end, 9), high], reversals_only=True)[1:],
    )
    steady = np.linspace(begin - 8, end + 6, 12)
    found.append(Excitable("plateaus, up and down", at(np.r_[steady, steady[::-1]]), total / 24))
    found.append(Excitable("long steps across the transition", at(np.tile([high, low], 5)), total / 10))
    found.append(Excitable(COVERING, at(random_levels(low, high, 120, seed=1)), max(total / 120, 2 * dt)))
    found.append(
        Excitable("random levels faster than the heat", at(random_levels(low, high, 1000, seed=2)), 5 * dt)
    )
    rest = np.full(20, low)
    found.append(
        Excitable(
            "cycles, rest, cycles",
            at(np.r_[np.tile([high, low], 12), rest, np.tile([high, low], 12)]),
            total / 68,
        )
    )
    dither = middle + 2.0 * np.tile([1.0, -1.0], 60)
    ramps("small loops inside the transition", np.r_[high, low, middle, dither, high, low])
    for name, centre in (("below", 0.5 * (low + begin)), ("inside", middle), ("above", 0.5 * (end + high))):
        wave = chirp(
            centre, 0.08 * (high - low), (1 / (0.2 * total), min(0.3 / dt, 6 / tau)), 0.9 * total, dt
        )
        found.append(Excitable(f"chirp {name} the transition", at(wave), dt))
    return found


def propose(
    problem: LinearisedProblem,
    nominal: Nominal,
    first: Explanation,
    second: Explanation,
    limits: Limits,
    *,
    names: tuple[str, str],
    say: Callable[[str], None] = lambda text: None,
) -> NextExperiment:
    """Return the experiment that separates two explanations best, or what to change by hand.

    Parameters
    ----------
    problem : of the recordings; its first part gives sample period and noise
    nominal : fitted simulation
    first, second : explanations that the recordings do not tell apart
    limits : how many standard deviations separate
    names : of the two, for the words
    say : called with what is being done

    Raises
    ------
    ValueError : no excitation for this device.
    """
    part = problem.parts[0]
    cold = preset(nominal.device).operating_range[0]
    best: tuple[float, Excitable] | None = None
    for excitable in library(nominal.device, part.dt):
        say(f"predicting: {excitable.name}")
        current = excitable.current(part.dt, cold)
        distance = _predicted(problem, nominal, first, second, current, part)
        if best is None or distance > best[0]:
            best = (distance, excitable)
    if best is None:
        raise ValueError("next experiment: found no excitation, need at least one")
    distance, excitable = best
    records = {h.record.id: h.record for e in (first, second) for h in e.hypotheses}
    if distance >= limits.separated:
        return NextExperiment(
            why=(
                f"What was recorded does not tell {names[0]} from {names[1]}; in this experiment they would differ by "
                f"{distance:.2g} standard deviations of the noise."
            ),
            separates=list(names),
            kind="excitation",
            excitation=excitable.playable(),
            instruction=f"Play {excitable.name} with `diagnose --next`, or with `identifier` and these levels, and give "
            "both bags to `diagnose`.",
        )
    needs = "; ".join(f"{n}: {records[n].excitation}" for n in names if n in records)
    return NextExperiment(
        why=(
            f"No excitation within the device's limits separates {names[0]} from {names[1]}: the best, "
            f"{excitable.name}, would by {distance:.1f} standard deviations."
        ),
        separates=list(names),
        kind="manual",
        excitation=None,
        instruction=f"Change by hand what only one of them feels, and record again. {needs}.",
    )


def by_hand(mimics: Sequence[Hypothesis]) -> NextExperiment | None:
    """Return what to do about effects that act all the time and so cannot be told from a changed constant; None for none.

    Parameters
    ----------
    mimics : such effects
    """
    if not mimics:
        return None
    names = [h.record.id for h in mimics]
    needs = "; ".join(f"{h.record.id}: {h.record.excitation}" for h in mimics)
    return NextExperiment(
        why=f"Throughout this recording {' or '.join(names)} may have been at work, or a constant has changed.",
        separates=[names[0], "unknown"],
        kind="manual",
        excitation=None,
        instruction=f"Change by hand what only the effect feels while recording. {needs}.",
    )


def to_cover(device: str, dt: float, why: str) -> NextExperiment:
    """Return an excitation of the whole operating range, where recordings agree with the model but cover little of it.

    Nothing was compared there: what it may show has no name, and it separates nothing.

    Parameters
    ----------
    device : preset or path of a device file
    dt : sample period [s]
    why : what was covered, as a clause
    """
    (excitable,) = (one for one in library(device, dt) if one.name == COVERING)
    return NextExperiment(
        why=f"{why}: what acts at other levels, in other loops or at other rates was not seen.",
        separates=["unknown", "unknown"],
        kind="excitation",
        excitation=excitable.playable(),
        instruction=f"Play {excitable.name} over the operating range with `diagnose --next`, or with `identifier` and these "
        "levels, and give both bags to `diagnose`.",
    )


def without_explanation(shapes: Sequence[Shape], likeliest: Sequence[Hypothesis]) -> NextExperiment:
    """Return what to record where nothing known explains an excess: what shows whether it follows what it seems to follow.

    Parameters
    ----------
    shapes : groups of functions that a correction without a name uses, most important first; none where it predicts nothing
    likeliest : effects of the best explanation that is not adequate; none where there is none
    """
    groups = dict.fromkeys(shape.group for shape in shapes)
    steps = list(dict.fromkeys([*(TO_SEE[group] for group in groups), REPEAT]))[:2]
    seems = (
        f"What is left follows {shapes[0].words}" if shapes else "What is left follows nothing that was tried"
    )
    name = likeliest[0].record.id if likeliest else "unknown"
    return NextExperiment(
        why=f"{seems}, and no known explanation is near enough to design an experiment for.",
        separates=["unknown", name],
        kind="manual",
        excitation=None,
        instruction=f"Record again, and give all bags to `diagnose`: {'; then '.join(steps)}.",
    )


def _predicted(
    problem: LinearisedProblem,
    nominal: Nominal,
    first: Explanation,
    second: Explanation,
    current: Floats,
    like: Part,
) -> float:
    """Distance of the predictions on a new recording after a refit of the second explanation and of the nuisance model."""
    n = current.size
    part = Part(
        "proposal", np.arange(n, dtype=np.float64) * float(like.dt), like.dt, current, like.channels,
        {c: np.zeros(n) for c in like.channels}, {c: np.ones(n, dtype=bool) for c in like.channels},
    )  # fmt: skip
    future = linearise_problem(
        nominal, [part], constants=problem.constants, effects=second.effects, shapes=problem.shapes
    )
    about = replace(future, included={})
    change = about.stack(about.responses(first.effects))
    tangent = []
    for k, name in second.coordinates:
        hypothesis = second.hypotheses[k]
        moved = [dict(v) for v in second.values]
        moved[k][name] = hypothesis.moved(name, second.values[k][name], 1.0)
        actual = hypothesis.distance(name, second.values[k][name], moved[k][name])
        if abs(actual) < A_STEP:
            moved[k][name] = hypothesis.moved(name, second.values[k][name], -1.0)
            actual = hypothesis.distance(name, second.values[k][name], moved[k][name])
        merged: dict[str, dict[str, float | str]] = {}
        for h, v in zip(second.hypotheses, moved, strict=True):
            merged |= h.effects(v)
        if actual:
            tangent.append(about.stack(about.responses(merged)) / actual)
    left = future.apply_inverse_covariance(change)
    total = float(change @ left)
    if tangent:
        columns = np.column_stack(tangent)
        weighted = future.apply_inverse_covariance(columns)
        normal = columns.T @ weighted + _known(second)
        right = weighted.T @ change
        total -= float(right @ np.linalg.solve(normal + 1e-9 * np.eye(len(tangent)), right))
    return float(np.sqrt(max(total, 0.0)))


def _known(explanation: Explanation) -> Floats:
    """Precision with which the recordings so far fix the parameters of an explanation."""
    covariance = np.asarray(explanation.covariance)
    return np.asarray(np.linalg.pinv(covariance)) if covariance.size else np.zeros((0, 0))
