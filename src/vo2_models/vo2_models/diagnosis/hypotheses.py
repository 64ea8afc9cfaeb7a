"""What could have been left out: every effect of the catalogue, on every signal, with starting values.

Nothing here knows an effect by name. Starting values follow from the record: its neutral values tell a
magnitude from a shape parameter, its typical range the size, its units where the recording itself can say
more (a frequency from the residual's spectrum, a limit or a step from the values).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from vo2_models.device.coefficients import HUGE
from vo2_models.diagnosis.nominal import Response
from vo2_models.diagnosis.problem import LATEST, LinearisedProblem
from vo2_models.effects import Effect, effects
from vo2_models.effects.record import CHOICE
from vo2_models.parameters import Parameter
from vo2_models.recording import HEATER_CURRENT, RESISTANCE

__all__ = ["MAGNITUDE_STEP", "Hypothesis", "hypotheses", "windowed"]

Floats = NDArray[np.float64]
Values = Mapping[str, float]
INSIDE = (1.0, 0.995, 0.98, 0.95, 0.9, 0.8, 0.6)
"""Shares of the values that a limit may leave as they are."""
BELOW = (0.005, 0.02, 0.05)
"""A limit of the drive below its largest value, as a share of the span: a drive that is held there has no value in between."""
SLOWEST = 3.0
"""Longest time constant that is looked for, in lengths of the longest recording."""
SHORTEST_LAG = 0.1
"""Shortest one, in sample periods."""
MAGNITUDE_STEP = 0.05
"""A step that matters of a magnitude, as a share of its typical size."""
ANGLE = "rad"
"""Unit of a phase, which is no magnitude: nothing is neutral about 0."""
PITCHES = 3
"""Pitches of a ripple that are tried, those which explain most of the residual."""
COARSE = 2.0
"""Least pitch of a ripple behind a coarse converter, in its steps: what is finer is the steps'."""
MOST_LATE, ENOUGH = 200, 20_000
"""Longest delay that is looked for sample by sample, below what the ring of a late channel holds; samples that tell it."""
LONG = 400_000
"""Values of all channels together from which that takes too long."""
APART = 24
"""Delays among these at which what the nuisance model leaves is looked at, before those near to the best."""
MOVED = (0.6, 0.8, 1.25, 1.6)
"""Factors by which a shape parameter of an effect that the model has already may have moved."""
CRESTS, MOST_CRESTS = 1.5, 100
"""Least and largest number of crests of a ripple over the values that were measured: fewer are a bend, more no start is near."""


@dataclass(frozen=True)
class Hypothesis:
    """One effect on one signal.

    Attributes
    ----------
    record : of the catalogue
    signal : channel it sits on, empty for none
    starts : starting values of the parameters that are fitted; one that a start leaves out stays neutral
    scales : parameter -> a step that matters
    fastest : half the sampling rate [Hz]; what oscillates faster is not seen to oscillate
    slowest : longest time constant [s]; what takes longer is seen as a straight line, or not to move
    widest : largest pitch of a ripple, in the signal's unit
    latest : longest delay of the current [s]
    """

    record: Effect
    signal: str
    starts: tuple[Values, ...]
    scales: Values
    fastest: float = np.inf
    slowest: float = np.inf
    widest: float = np.inf
    latest: float = np.inf

    @property
    def key(self) -> str:
        """Id, with the signal where there is one."""
        return f"{self.record.id}:{self.signal}" if self.signal else self.record.id

    def effects(self, values: Values) -> dict[str, dict[str, float | str]]:
        """Return what `Simulation.with_effects` takes."""
        given: dict[str, float | str] = dict(values)
        return {self.key: {**given, "signal": self.signal} if self.signal else given}

    def parameter(self, name: str) -> Parameter:
        """Record of a parameter."""
        return next(p for p in self.record.parameters if p.name == name)

    @property
    def switches(self) -> tuple[str, ...]:
        """Parameters that are times at which the effect goes on and off."""
        return tuple(p.name for p in self.record.parameters if p.unit == "s" and abs(_neutral(p)) >= HUGE)

    @property
    def walls(self) -> tuple[str, ...]:
        """Parameters at which a channel's values end."""
        return tuple(
            p.name for p in self.record.parameters if p.unit == "channel unit" and abs(_neutral(p)) >= HUGE
        )

    @property
    def choices(self) -> tuple[str, ...]:
        """Parameters that are not fitted: alternatives are tried both ways."""
        return tuple(p.name for p in self.record.parameters if p.unit == CHOICE)

    @property
    def magnitudes(self) -> tuple[str, ...]:
        """Fitted parameters in which the effect is linear as long as it is small, and which are neutral at zero."""
        fitted = self.starts[0]
        return tuple(
            n
            for n in fitted
            if _neutral(self.parameter(n)) == 0.0
            and not self.logarithmic(n)
            and n not in self.choices
            and self.parameter(n).unit != ANGLE
        )

    def bounds(self, name: str) -> tuple[float, float]:
        """Physical range, of a frequency, a time constant, a delay and a pitch what the samples can show of it."""
        parameter = self.parameter(name)
        lower, upper = float(parameter.lower or 0.0), float(parameter.upper or 0.0)
        if parameter.unit == "Hz":
            upper = min(upper, self.fastest)
        elif parameter.unit == "s" and self.logarithmic(name):
            upper = min(upper, self.slowest)
            if name == "time_constant":  # what is over at once is a gain
                lower = max(lower, SHORTEST_LAG * 0.5 / self.fastest)
        elif self._is_pitch(name):
            upper = min(upper, self.widest)
        elif "delay" in self.record.hooks:
            upper = min(upper, self.latest)
        return lower, upper

    def _is_pitch(self, name: str) -> bool:
        """Whether it is the pitch of a ripple along the signal's values."""
        return _is_pitch(self.parameter(name), self.record)

    def ends(self, name: str, value: float) -> bool:
        """Whether a value is at the end of what is physical; nothing and anything are no ends."""
        return any(
            np.isclose(value, end, rtol=1e-6, atol=0.0) and abs(end) < 1e9 and end != 0.0
            for end in self.bounds(name)
        )

    def logarithmic(self, name: str) -> bool:
        """Whether it is fitted by its logarithm: a shape parameter, which is positive and not neutral at zero."""
        parameter = self.parameter(name)
        return float(parameter.default) > 0 and float(parameter.lower or 0.0) > 0  # type: ignore[arg-type]

    def moved(self, name: str, value: float, step: float) -> float:
        """Return a value after a step in the parameter's coordinate, in units of its scale, inside the bounds."""
        change = step * self.scales[name]
        if self.logarithmic(name):
            return float(np.clip(value * np.exp(np.clip(change, -2, 2)), *self.bounds(name)))
        return float(np.clip(value + change, *self.bounds(name)))

    def distance(self, name: str, old: float, new: float) -> float:
        """Return the difference of two values in the parameter's coordinate, in units of its scale."""
        scale = self.scales[name]
        if self.logarithmic(name):
            return float(np.log(new / old)) / scale if old > 0 and new > 0 else 0.0
        return (new - old) / scale


def hypotheses(problem: LinearisedProblem, device: str, residual: Floats) -> list[Hypothesis]:
    """Return every hypothesis that can show in the recordings' channels, those but that the values show by themselves.

    Parameters
    ----------
    problem : the problem
    device : preset id
    residual : (N,) what is to be explained, whitened, nuisance model taken out
    """
    measured = {row.channel for row in problem.rows}
    found = []
    for record in effects().values():
        if not record.occurs_on(device) or "line" in record.hooks:
            continue
        for signal in record.signals(device):
            if not measured & set(record.reaches(device, signal)):
                continue
            if any((record.id, signal) in part.evident for part in problem.parts):
                continue
            if "evident" in record.hooks and any(part.comb.get(signal) for part in problem.parts):
                continue  # a converter whose steps are seen shows its limits as well: within a step they are its rounding
            starts, scales = _starts(problem, record, signal, device, residual)
            if starts:
                fastest = 0.5 / max(part.dt for part in problem.parts)
                slowest = SLOWEST * max(part.size * part.dt for part in problem.parts)
                widest = float(np.ptp(_values(problem, signal))) / CRESTS if signal else np.inf
                latest = LATEST * min(part.dt for part in problem.parts)
                one = Hypothesis(record, signal, tuple(starts), scales, fastest, slowest, widest, latest)
                if known := problem.nominal.model.effects.get(one.key):
                    one = replace(one, starts=_moved_shapes(one, known))
                    if not one.starts:
                        continue  # the device has it, as it stands in the model
                inside = tuple(
                    {n: min(v, one.bounds(n)[1]) if one.logarithmic(n) else v for n, v in start.items()}
                    for start in one.starts
                )
                found.append(windowed(problem, replace(one, starts=inside), residual))
    return found


def _moved_shapes(hypothesis: Hypothesis, known: Mapping[str, float | str]) -> tuple[Values, ...]:
    """Starts about what a model has of an effect already: each of its shape parameters moved, such as the frequency of a mode."""
    own = {name: float(value) for name, value in known.items() if name != "signal"}
    shapes = [name for name in own if name in hypothesis.starts[0] and hypothesis.logarithmic(name)]
    return tuple({**own, name: own[name] * by} for name in shapes for by in MOVED)


def windowed(problem: LinearisedProblem, hypothesis: Hypothesis, residual: Floats) -> Hypothesis:
    """The hypothesis, begun on and off again too, where it goes on and off at all, when the residual asks for it.

    Parameters
    ----------
    problem : the problem
    hypothesis : with or without such starts; those of another residual are dropped
    residual : (N,) what is to be explained, whitened, nuisance model taken out

    Returns
    -------
    the same hypothesis where it does not go on and off
    """
    if len(hypothesis.switches) != 2:
        return hypothesis
    on, off = hypothesis.switches
    lasting = [start for start in hypothesis.starts if on not in start]
    windows = _windows(problem, hypothesis.record, hypothesis.signal, lasting[0], (on, off), residual)
    length = max(part.time_s[-1] - part.time_s[0] for part in problem.parts)
    return replace(
        hypothesis,
        starts=(*lasting, *({**start, on: a, off: b} for start in lasting[::2] for a, b in windows)),
        scales={**hypothesis.scales, **dict.fromkeys((on, off), float(2e-3 * length))},
    )


def _starts(
    problem: LinearisedProblem, record: Effect, signal: str, device: str, residual: Floats
) -> tuple[list[dict[str, float]], dict[str, float]]:
    typical = record.magnitudes(device, signal)
    free = [p for p in record.parameters if p.name not in record.fixed]
    limits = [p for p in free if abs(_neutral(p)) >= HUGE and p.unit in ("A", "channel unit")]
    if limits:  # flat tops: each limit by itself, at places where the values end
        starts: list[dict[str, float]] = []
        scales: dict[str, float] = {}
        for p in limits:
            seen = _values(problem, signal or HEATER_CURRENT)
            spread = float(np.ptp(seen))
            upper = _neutral(p) > 0
            inside = np.array(INSIDE)
            ends = np.quantile(seen, inside if upper else 1.0 - inside)
            if not signal:
                ends = np.append(ends, np.max(seen) - spread * np.array(BELOW))
            starts += [{p.name: float(end)} for end in dict.fromkeys(ends.tolist())]
            scales[p.name] = 0.02 * spread
        return starts, scales
    grids: dict[str, list[float]] = {}
    scales = {}
    for p in free:
        low, high = typical.get(p.name, (0.0, 0.0))
        middle = float(np.sqrt(low * high)) if low > 0 else 0.0
        if p.unit == CHOICE:
            grids[p.name] = [0.0, 1.0]
            scales[p.name] = 1.0
        elif p.unit == "Hz":
            grids[p.name] = _frequencies(problem, record, signal, device, residual)
            scales[p.name] = 0.02
        elif p.unit == ANGLE:
            grids[p.name] = [0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi]  # an amplitude is not negative
            scales[p.name] = 0.05
        elif middle and signal and _is_pitch(p, record):
            grids[p.name] = _pitches(problem, signal, residual, low / 3)
            scales[p.name] = 0.02
        elif _neutral(p) == 0.0 and not middle:
            grids[p.name] = [0.0]
            scales[p.name] = 0.0  # set below, from the other magnitudes
        elif _neutral(p) == 0.0:
            # one sign is enough: the score tells the other
            grids[p.name] = (
                [middle] if sum(q.unit != CHOICE for q in free) > 1 else [0.4 * middle, 2.0 * middle]
            )
            scales[p.name] = MAGNITUDE_STEP * middle
            if p.name == "delay":  # far from the true one nothing leads to it
                grids[p.name] += _lateness(problem, record.reaches(device, signal))
        elif middle:
            # beside a frequency that the residual tells, the rest matters less; by itself, nothing helps a start far off
            alone = int(np.ceil(np.log2(9.0 * high / low))) + 1
            count = 2 if any(q.unit == "Hz" for q in free) else 5 if len(free) > 1 else alone
            grids[p.name] = np.geomspace(low / 3, high * 3, count).tolist()
            scales[p.name] = 0.05
        else:
            grids[p.name] = [_neutral(p)]
            scales[p.name] = 0.05
    for p in free:
        if scales[p.name] == 0.0:  # a magnitude without typical value: what the whole recording makes visible
            length = max(part.time_s[-1] - part.time_s[0] for part in problem.parts)
            first = next((v for n, v in scales.items() if v), 0.0)
            scales[p.name] = first / length if p.unit.endswith("s^2") else first
    starts = []
    for combination in product(*grids.values()):
        values = dict(zip(grids, combination, strict=True))
        starts.append({n: _clipped(record, n, v) for n, v in values.items()})
    return starts, scales


def _windows(
    problem: LinearisedProblem,
    record: Effect,
    signal: str,
    start: Values,
    names: tuple[str, str],
    residual: Floats,
    *,
    pieces: int = 30,
    most: int = 3,
) -> list[tuple[float, float]]:
    """Times of switching on and off that explain most, best first; none where being on all the time does as well.

    What was switched leaves a memory: the effect of a window is the difference of two effects that stay on, one from the
    begin and one from the end of it. Times are told from the start of each recording, and are the same in all of them.
    """
    length = max(part.size * part.dt for part in problem.parts)
    times = np.linspace(0.0, length, pieces + 1)[:-1]
    given: dict[str, float | str] = {**start, **({"signal": signal} if signal else {})}
    key = f"{record.id}:{signal}" if signal else record.id
    lasting = np.column_stack(problem.deviations([{key: {**given, names[0]: float(t)}} for t in times]))
    gram = np.zeros((pieces + 1, pieces + 1))  # the last is never on
    gram[:-1, :-1] = lasting.T @ problem.apply_inverse_covariance(lasting)
    along = np.append(residual @ lasting, 0.0)
    begin, end = np.triu_indices(pieces + 1, 2)
    own = gram[begin, begin] + gram[end, end] - 2.0 * gram[begin, end]
    gain = (along[begin] - along[end]) ** 2 / np.maximum(own, 1e-9)
    always = float(gain[(begin == 0) & (end == pieces)][0])
    edges = np.append(times, HUGE)
    order = [k for k in np.argsort(-gain)[:most] if gain[k] > 1.1 * always]
    return [(float(times[begin[k]]), float(edges[end[k]])) for k in order]


def _neutral(parameter: Parameter) -> float:
    return float(parameter.default)  # type: ignore[arg-type]


def _clipped(record: Effect, name: str, value: float) -> float:
    parameter = next(p for p in record.parameters if p.name == name)
    return float(np.clip(value, parameter.lower, parameter.upper))


def _values(problem: LinearisedProblem, channel: str) -> Floats:
    """All values of a channel in its own unit; of the drive where the current is not compared."""
    found = []
    for part in problem.parts:
        if channel in part.observed:
            values = part.observed[channel][part.valid[channel]]
            found.append(10.0**values if channel == RESISTANCE else values)
        elif channel == HEATER_CURRENT:
            found.append(np.abs(part.current))
    values = np.concatenate(found) if found else np.zeros(1)
    return np.abs(values) if channel == HEATER_CURRENT else values


def _frequencies(
    problem: LinearisedProblem, record: Effect, signal: str, device: str, residual: Floats
) -> list[float]:
    """Peaks of the residual's spectrum in the channels that the effect reaches, and a coarse grid [Hz]."""
    reached = record.reaches(device, signal)
    found: list[float] = []
    for row, part, _ in problem.iterate():
        if row.channel not in reached:
            continue
        size = min(2048, part.size)
        frequency, power = welch(residual[row.where], fs=1.0 / part.dt, nperseg=size)
        inner = slice(3, -1)
        order = np.argsort(power[inner])[::-1]
        for k in order:
            candidate = float(frequency[inner][k])
            if all(abs(np.log(candidate / f)) > 0.15 for f in found):
                found.append(candidate)
            if len(found) >= 6:
                break
    return found


def _lateness(problem: LinearisedProblem, channels: Sequence[str]) -> list[float]:
    """Delays [s] of whole samples at which the simulation is nearest to these channels; none where they are not late.

    By the squared distance over the noise of the measured values from the simulated ones, which are `MOST_LATE` samples older at
    most, constants moved and not; and by what the nuisance model leaves of that distance: constants that have moved hide a
    delay, or look like one. Of long recordings by the first alone, which looks at some samples only.
    """
    simulations = [problem.nominal_responses]
    # constants that have moved to make up for a delay hide it: a gain of the other sign, for one
    if np.any(problem.origin):
        simulations.append(tuple(problem.responses({}, np.zeros(problem.origin.size))))
    misfit = np.zeros((len(simulations), MOST_LATE + 1))
    for row, part, _ in problem.iterate():
        if row.channel not in channels:
            continue
        counts = np.flatnonzero(problem.weight[row.where] > 0)
        counts = counts[:: max(1, counts.size // ENOUGH)]
        measured, noise = part.observed[row.channel][counts], problem.nominal.noise[row.channel].level
        for far, responses in zip(misfit, simulations, strict=True):
            simulated = responses[row.part].channels[row.channel]
            for late in range(MOST_LATE + 1):
                far[late] += (
                    float(np.sum((measured - simulated[np.maximum(counts - late, 0)]) ** 2)) / noise**2
                )

    best, period = {int(place) for place in np.argmin(misfit, axis=1)}, max(part.dt for part in problem.parts)
    if problem.weight.size > LONG:
        return [late * period for late in best - {0}]

    def nearest(some: Sequence[int]) -> int:
        """The one that leaves least."""
        columns = [problem.residual - problem.stack(_late(problem, channels, late)) for late in some]
        return int(np.argmin(problem.chi_squares(np.column_stack(columns))))

    apart = [0, *np.unique(np.round(np.geomspace(1, MOST_LATE, APART)).astype(int)).tolist()]
    place = nearest(apart)
    near = range(apart[max(place - 1, 0)], apart[min(place + 1, len(apart) - 1)] + 1)
    near = near[:: max(1, len(near) // APART)]
    best.add(near[nearest(near)])
    return [late * period for late in sorted(best - {0})]


def _late(problem: LinearisedProblem, channels: Sequence[str], late: int) -> list[Response]:
    """The nominal responses with some channels as they were so many samples before."""
    return [
        replace(
            response,
            channels={
                c: values[np.maximum(np.arange(values.size) - late, 0)] if c in channels else values
                for c, values in response.channels.items()
            },
        )
        for response in problem.nominal_responses
    ]


def _is_pitch(parameter: Parameter, record: Effect) -> bool:
    ripples = any(p.unit == ANGLE for p in record.parameters)
    return ripples and parameter.unit == "channel unit" and _neutral(parameter) != 0.0


def _pitches(problem: LinearisedProblem, signal: str, residual: Floats, finest: float) -> list[float]:
    """Periods along a channel's values, in its unit, in which its residual swings most, best first.

    Power of the residual at 1 / pitch over values in place of the time, at a quarter of a crest over their span: over the
    measured ones, and over the simulated ones, which a ripple that is steep has not folded.
    """
    measured, simulated, left = [], [], []
    for row, part, response in problem.iterate():
        if row.channel == signal:
            counts = problem.weight[row.where] > 0
            measured.append(part.observed[signal][counts])
            simulated.append(response.channels[signal][counts])
            left.append(problem.in_its_unit(row, residual)[counts])
    r = np.concatenate([[], *left])
    if r.size == 0:
        return [3.0 * finest]
    stride = max(1, r.size // 20_000)
    r = r[::stride] - np.mean(r)
    values = [np.concatenate(each)[::stride] for each in (measured, simulated)]
    span = max(float(np.ptp(values[0])), CRESTS * finest)
    step = max(part.comb.get(signal, 0.0) for part in problem.parts)
    finest = max(finest, span / MOST_CRESTS, COARSE * step)  # a converter's steps are no crests
    per_unit = np.arange(CRESTS / span, 1.0 / finest + 0.25 / span, 0.25 / span)

    def power(frequencies: Floats) -> Floats:
        return np.max(
            [[np.abs(r @ np.exp(-2j * np.pi * f * y)) for f in frequencies] for y in values], axis=0
        )

    found: list[float] = []
    for f in per_unit[np.argsort(-power(per_unit))]:
        if all(abs(f - 1.0 / pitch) > 0.5 / span for pitch in found):
            near = f + np.linspace(-0.25, 0.25, 11) / span
            found.append(1.0 / float(near[np.argmax(power(near))]))
        if len(found) == PITCHES:
            break
    # a gain that has moved acts behind the ripple
    gain = problem.moved(problem.origin).get("deflection.gain", 1.0)
    return [pitch / gain for pitch in found]
