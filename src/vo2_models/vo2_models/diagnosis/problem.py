"""One whitened problem out of several recordings, and what the nuisance model of loop shape and heat can absorb of it.

With r the whitened residual of the nominal simulation, B the whitened tangent of the nuisance model (loop-shape
corrections as uncertain as the calibration left them, thermal parameters as uncertain as the fit says),
every column scaled to a unit normal weight, the nuisance model absorbs

    b = (B'B + I)^-1 B'r ,   and what is left weighs   chi^2(r) = r'r - r'B (B'B + I)^-1 B'r .

It is the chi-square of the residual under noise and nuisance model together, so an effect is judged by how much it
lowers it: the refit of the nuisance model is in it, without being made.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from vo2_models.device.simulation import FINE
from vo2_models.device.state import CURRENT_LINE
from vo2_models.diagnosis.bend import Bend
from vo2_models.diagnosis.current_reading import between_samples
from vo2_models.diagnosis.loop_shape import LoopShape, loop_shapes
from vo2_models.diagnosis.misfit import NO_MISFIT, Whitening
from vo2_models.diagnosis.noise import NoiseModel, samples_apart
from vo2_models.diagnosis.nominal import Nominal, Response
from vo2_models.diagnosis.nuisance import Constant, constants_of, law_columns
from vo2_models.diagnosis.part import Part
from vo2_models.diagnosis.propagate_correction import as_sensed
from vo2_models.diagnosis.tangent import Tangent
from vo2_models.effects import effects as records
from vo2_models.numerics.parallel import parallel_map
from vo2_models.recording import HEATER_CURRENT, RESISTANCE

__all__ = ["LinearisedProblem", "LoopColumns", "Row", "at_sensor", "linearise_problem"]

Floats = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float | str]]
QUICKEST = 0.2
"""Least time constant that the nuisance model may ask for, as a share of the calibration's, which may hardly tell it."""
LATEST = CURRENT_LINE // (2 * FINE) - 1
"""Most dead time that constants, and that effects beside them, may ask for, in sample periods: the current's line holds both,
of a simulation between the samples, too."""
STEP = 0.2
"""Step of a constant by which its column is taken, as a share of what the simulation is linear over."""
MOST, MOST_REFITTED = 260, 420
"""Directions of a loop's shape that are kept: where the calibration has fixed the loop, and where it is fitted anew."""
STILL_K = 0.1
"""Move of a temperature path over which the loop columns are taken as unchanged [K]."""


@dataclass(frozen=True)
class Row:
    """Where one channel of one recording stands in the stacked vectors."""

    part: int
    channel: str
    where: slice


@dataclass(frozen=True)
class LinearisedProblem:
    """The stacked, whitened problem.

    Attributes
    ----------
    nominal : with loop-shape corrections
    origin : (t,) move of the thermal parameters, in units of their columns, about which everything is linear
    parts : recordings
    rows : layout of the stacked vectors
    weight : (N,) 0 where a sample is missing, else what divides the innovation (1 without rough misfit)
    whitening : one per row
    nominal_responses : one per part
    residual : (N,) whitened residual of the nominal simulation
    nuisance : (N, k) whitened tangent of the nuisance model
    loops : channel -> the loop columns that were kept, and where they were taken
    loop_coupling : (N, t) what of the thermal columns is the loops' doing: the calibration has fixed them together with the lags
    loop_origin : channel -> weights of its kept loop columns about which everything is linear; absent for none
    refits : whether the nominal device is fitted anew, so that it is linearised about its refitted loops as well
    constants : of the thermal columns, which are the last; a unit of each is its `spread`
    included : effects that the nominal responses already have
    courses : key -> how each effect that may bend in time does so, about which everything is linear, see the module of that name
    bent : (N,) what the columns of the courses say of that, so that the nuisance model pays for it; empty for nothing
    shapes : posterior of the loop shapes behind the nuisance model
    """

    nominal: Nominal
    origin: Floats
    parts: tuple[Part, ...]
    rows: tuple[Row, ...]
    weight: Floats
    whitening: tuple[Whitening, ...]
    nominal_responses: tuple[Response, ...]
    residual: Floats
    nuisance: Tangent
    constants: tuple[Constant, ...]
    included: Effects = field(default_factory=dict)
    shapes: Mapping[str, LoopShape] = field(default_factory=dict)
    loops: Mapping[str, LoopColumns] = field(default_factory=dict)
    loop_coupling: Floats = field(default_factory=lambda: np.zeros((1, 1)))
    loop_origin: Mapping[str, Floats] = field(default_factory=dict)
    refits: bool = False
    courses: Mapping[str, Bend] = field(default_factory=dict)
    bent: Floats = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        gram = self.nuisance.gram()
        gram[np.diag_indices_from(gram)] += 1.0
        object.__setattr__(self, "_factor", cho_factor(gram, lower=True))

    @property
    def count(self) -> int:
        """Number of samples that count."""
        return int(np.count_nonzero(self.weight))

    @property
    def count_by_channel(self) -> dict[str, int]:
        """The same of each channel."""
        found: dict[str, int] = {}
        for row in self.rows:
            found[row.channel] = found.get(row.channel, 0) + int(np.count_nonzero(self.weight[row.where]))
        return found

    def energy_by_channel(self, vector: Floats, left: Floats) -> dict[str, float]:
        """Each channel's part of a whitened residual's (N,) chi-square; `left` (N,) is what the nuisance model leaves of it.

        Where constants went far, one channel may have far too much and another less than nothing: then what the moves cost,
        about which everything is linear, is shared by the channels' samples.
        """

        def split(own: Floats) -> dict[str, float]:
            found: dict[str, float] = {}
            for row in self.rows:
                found[row.channel] = found.get(row.channel, 0.0) + float(own[row.where] @ left[row.where])
            return found

        found = split(vector)
        if self.refits or min(found.values(), default=0.0) >= 0.0:
            return found
        moved = self.nuisance.thermal @ self.origin
        share = float(moved @ left) / max(self.count, 1)
        return {c: e + share * self.count_by_channel[c] for c, e in split(vector - moved).items()}

    def responses(
        self, effects: Effects, shift: Floats | None = None, *, fine: bool = True, only: int | None = None
    ) -> list[Response]:
        """Simulate every part with effects beside the included ones, thermal parameters moved by `shift` columns.

        With `only`, that part alone; the others are as they are nominally.
        """
        shift = self.origin if shift is None else shift
        given = {**self.included, **effects}
        return [
            self.nominal.respond(
                part.current,
                part.dt,
                effects=given,
                constants=self.moved(shift, place),
                settled=part.settled,
                fine=fine,
                course=_course(self.courses, given, place, part),
            )
            if only in (None, place)
            else self.nominal_responses[place]
            for place, part in enumerate(self.parts)
        ]

    def moved(self, shift: Floats, place: int | None = None) -> dict[str, float]:
        """Constants moved from the model's by `shift` (t,), in units of their columns: of one recording, or of all on average."""
        return _moved(self.constants, shift, self.parts, place)

    def curved(self, move: Floats) -> float:
        """Largest part of a move (t,) of the constants, in units of what the simulation is linear over."""
        return float(np.max(np.abs(self.in_straights(move)), initial=0.0))

    def in_straights(self, move: Floats) -> Floats:
        """A move (t,) of the constants, each in units of what the simulation is linear over."""
        return move / np.array([c.straight for c in self.constants])

    def loop_weights(self, weights: Floats) -> dict[str, Floats]:
        """Those of the nuisance model's weights (k,) that are of loop columns, by channel."""
        found, start = {}, 0
        for channel, columns in self.loops.items():
            found[channel] = weights[start : start + columns.raw[0].shape[1]]
            start += columns.raw[0].shape[1]
        return found

    def column_of(self, name: str) -> int | None:
        """Which of the thermal columns is that of a constant in all recordings; None for none."""
        return next((k for k, c in enumerate(self.constants) if c.name == name and c.part is None), None)

    def stack(self, responses: Sequence[Response], reference: Sequence[Response] | None = None) -> Floats:
        """Whitened (N,) difference of responses from a reference (by default the nominal ones)."""
        known = self.nominal_responses if reference is None else reference
        out = np.empty(self.weight.size)
        for row, whiten in zip(self.rows, self.whitening, strict=True):
            new = responses[row.part].channels[row.channel]
            old = known[row.part].channels[row.channel]
            out[row.where] = whiten(new - old)
        return out * (self.weight > 0.0)

    def whiten(self, row: Row, columns: Floats) -> Floats:
        """Whiten (n,) or (n, p) in a channel's unit, as the residual was."""
        return self.whitening[self.rows.index(row)](columns)

    @cached_property
    def responses_as_fitted(self) -> tuple[Response, ...]:
        """Responses of every part of the model as it is: no effect beside its own, no constant moved, no loop refitted."""
        model = replace(self.nominal, corrections={})
        return tuple(model.respond(part.current, part.dt, settled=part.settled) for part in self.parts)

    def residual_as_fitted(self, row: Row) -> Floats:
        """Measured minus simulated (n,) by the model as it is, in the channel's unit; 0 where a sample is missing."""
        part, simulated = self.parts[row.part], self.responses_as_fitted[row.part].channels[row.channel]
        return np.where(part.valid[row.channel], part.observed[row.channel] - simulated, 0.0)

    def misfit_in(self, row: Row) -> bool:
        """Whether the device's own misfit is expected in a channel."""
        return bool(np.any(self.whitening[self.rows.index(row)].slope))

    def in_its_unit(self, row: Row, vector: Floats) -> Floats:
        """Values (n,) of a channel, in its unit, whose whitened form stands in a vector (N,)."""
        return self.whitening[self.rows.index(row)].undo(vector[row.where])

    def deviation(self, effects: Effects, shift: Floats | None = None, *, fine: bool = True) -> Floats:
        """Whitened (N,) change of the simulation that effects make.

        With `shift`, thermal parameters are moved that far from the model's, and what the linear nuisance model says of that
        move is taken off again: the nuisance model still pays for the move, but its curvature is in the deviation.
        """
        change = self.stack(self.responses(effects, shift, fine=fine))
        if shift is not None and shift.size:
            change = change - (self.nuisance.thermal - self.loop_coupling) @ (shift - self.origin)
        return change

    def deviations(
        self, several: Sequence[Effects], shift: Floats | None = None, *, fine: bool = True
    ) -> list[Floats]:
        """`deviation` of several sets of effects, simulated side by side on the cores."""
        return parallel_map(lambda effects: self.deviation(effects, shift, fine=fine), several)

    def nuisance_weights(self, against: Floats) -> Floats:
        """Weights (k,) or (k, p) with which the nuisance model absorbs a whitened vector v, from B'v: (B'B + I)^-1 B'v."""
        return np.asarray(cho_solve(self._factor, against, check_finite=False))  # type: ignore[attr-defined]

    def fit_nuisance(self, vector: Floats) -> Floats:
        """Weights (k,) with which the nuisance model absorbs a whitened vector."""
        return self.nuisance_weights(self.nuisance.against(vector))

    def apply_inverse_covariance(self, vector: Floats) -> Floats:
        """What the nuisance model leaves of a whitened vector (or columns): C^-1 v, C the covariance of both."""
        return vector - self.nuisance.times(self.fit_nuisance(vector))

    def apply_inverse_covariance_in(self, rows: slice, columns: Floats) -> Floats:
        """What the nuisance model leaves of whitened columns (n, p) of one channel that are zero in all others."""
        inner = self.nuisance_weights(self.nuisance.against_rows(rows, columns))
        return columns - self.nuisance.times_rows(rows, inner)

    @cached_property
    def residual_chi_square(self) -> float:
        """Chi-square of the residual."""
        return self.chi_square(self.residual)

    def chi_square(self, vector: Floats, against: Floats | None = None) -> float:
        """Chi-square of a whitened vector v; `against` is B'v where that is known."""
        inner = self.nuisance.against(vector) if against is None else against
        return float(vector @ vector - inner @ self.nuisance_weights(inner))

    def chi_square_by_part(self, vector: Floats) -> Floats:
        """What each recording has of the chi-square of a whitened vector, (number of recordings,)."""
        left, found = self.apply_inverse_covariance(vector), np.zeros(len(self.parts))
        for row in self.rows:
            found[row.part] += float(vector[row.where] @ left[row.where])
        return found

    def chi_squares(self, columns: Floats) -> Floats:
        """Chi-square of each of the whitened columns (N, m)."""
        inner = self.nuisance.against(columns)
        return np.asarray(np.sum(columns**2, axis=0) - np.sum(inner * self.nuisance_weights(inner), axis=0))

    def restricted(self, keep: NDArray[np.bool_]) -> LinearisedProblem:
        """The same problem with only some samples counting: for a fit that leaves blocks out."""
        weight = np.where(keep, self.weight, 0.0)
        return replace(
            self,
            weight=weight,
            residual=np.where(keep, self.residual, 0.0),
            nuisance=self.nuisance.restricted(keep),
            loop_coupling=self.loop_coupling * keep[:, None],
        )

    def rows_of(self, channel: str) -> slice:
        """Where a channel stands, over all recordings."""
        own = [row.where for row in self.rows if row.channel == channel]
        return slice(own[0].start, own[-1].stop)

    def over_stretches(self, values: Floats, *, stretches: int = 24) -> Floats:
        """Sums (m,) or (m, p) of what stands in stacked vectors (N,) or (N, p) over long stretches of time of each recording.

        A stretch is one piece of evidence for all channels together: misfit goes on over many samples and through all of them.
        """
        found = []
        for index, part in enumerate(self.parts):
            edges = np.arange(stretches) * part.size // stretches
            own = [row.where for row in self.rows if row.part == index]
            found.append(np.sum([np.add.reduceat(values[where], edges, axis=0) for where in own], axis=0))
        return np.concatenate(found)

    def iterate(self) -> Iterator[tuple[Row, Part, Response]]:
        """Rows with their recording and nominal response."""
        for row in self.rows:
            yield row, self.parts[row.part], self.nominal_responses[row.part]


def linearise_problem(
    nominal: Nominal,
    parts: Sequence[Part],
    *,
    shift: Floats | None = None,
    constants: Sequence[Constant] | None = None,
    effects: Effects | None = None,
    shapes: Mapping[str, LoopShape] | None = None,
    loops: Mapping[str, LoopColumns] | None = None,
    loop_origin: Mapping[str, Floats] | None = None,
    refits: bool = False,
    courses: Mapping[str, Bend] | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> LinearisedProblem:
    """Build the problem: loop shape from the calibration, simulation of every part, whitened nuisance model.

    Parameters
    ----------
    nominal : without corrections
    parts : recordings, as `part.prepare` made them
    shift : move of the thermal parameters to linearise about; the nuisance model pays for it as for its own moves
    constants : that a refit may move; by default those of another day, and what the calibration left open
    effects : effects to linearise about
    shapes : posterior of the loop shapes, where it is known already
    loops : columns of an earlier problem: their directions are kept, and they themselves where the
        temperatures have hardly moved
    loop_origin : weights of these columns, by channel, to linearise about; the nuisance model pays for them as well
    refits : whether the nominal device is fitted anew
    courses : how the effects bend in time; their columns are not there yet, see `courses.with_courses`
    say : called with what is being done

    Returns
    -------
    the problem about the given effects and constants, its residual included
    """
    shapes = loop_shapes(nominal) if shapes is None else shapes
    constants = tuple(constants_of(nominal) if constants is None else constants)
    origin = _possible(constants, np.zeros(len(constants)) if shift is None else shift)
    moved = {c.name: float(z) * c.spread for c, z in zip(constants, origin, strict=True) if not c.drifts}
    # the columns of the law itself stay linear: it is not rewritten
    about = {
        c: np.where(np.arange(z.size) < loops[c].shared, z, 0.0)
        for c, z in (loop_origin or {}).items()
        if loops
    }
    corrected = replace(
        nominal,
        corrections={
            c: s.moved(loops[c].directions @ about[c][: loops[c].shared]).fold(moved)
            if loops and c in about
            else s.fold(moved)
            for c, s in shapes.items()
        },
    )
    say("simulating the recordings")
    responses = [
        corrected.respond(
            p.current,
            p.dt,
            effects=effects,
            constants=_moved(constants, origin, parts, place),
            settled=p.settled,
            course=_course(courses or {}, effects or {}, place, p),
        )
        for place, p in enumerate(parts)
    ]
    rows, end = [], 0
    for channel in dict.fromkeys(channel for part in parts for channel in part.channels):
        for index, part in enumerate(parts):
            if channel in part.channels:
                rows.append(Row(index, channel, slice(end, end + part.size)))
                end += part.size
    weight = np.empty(end)
    residual = np.empty(end)
    whitening = []
    for row in rows:
        part, response = parts[row.part], responses[row.part]
        measured, counts = part.observed[row.channel], part.valid[row.channel]
        noise = corrected.noise[row.channel].every(samples_apart(counts))
        predicted = response.channels[row.channel]
        rough: Floats | float = 0.0
        if row.channel in shapes:
            rough = shapes[row.channel].rough_at(response.temperature)
        elif row.channel == HEATER_CURRENT and part.read_late:
            rough = between_samples(measured, noise.level)
        weight[row.where] = _reach(counts, noise) / np.sqrt(
            1.0 + (rough**2 + part.rounding(row.channel, predicted) ** 2) / noise.level**2
        )
        shape, path = shapes.get(row.channel), response.temperature
        misfit, inside = (
            (shape.misfit, shape.inside(path)) if shape else (NO_MISFIT, np.zeros(path.size, bool))
        )
        along = Whitening.along(path, noise, weight[row.where], misfit, inside)
        whitening.append(replace(along, size=part.uneven.get(row.channel, along.size)))
        residual[row.where] = whitening[-1](np.where(counts, measured - predicted, 0.0))
    kept = _loop_columns(shapes, rows, responses, corrected, whitening, loops or {}, refits=refits)
    blocks = _whitened(kept, rows, parts, corrected, effects or {}, whitening)
    partial = LinearisedProblem(
        corrected, origin, tuple(parts), tuple(rows), weight, tuple(whitening), tuple(responses),
        residual,
        Tangent((), np.zeros((end, 0))), constants, dict(effects or {}), shapes, kept, loop_origin=about,
        refits=refits, courses=courses or {},
    )  # fmt: skip

    thermal_columns = _constant_columns(partial)
    coupling = _loop_coupling(partial)
    nuisance = Tangent(blocks, thermal_columns + coupling)
    # told from the model's own thermal parameters, so that the nuisance model pays for the origin too
    if origin.size:
        residual = residual + nuisance.thermal @ origin
    for (where, block), channel in zip(blocks, kept, strict=True):
        if channel in about:
            residual[where] += block @ about[channel]
    return replace(
        partial,
        residual=residual,
        nuisance=nuisance,
        loop_coupling=coupling,
    )


def _course(
    courses: Mapping[str, Bend], effects: Effects, place: int, part: Part
) -> tuple[str, Floats] | None:
    """The effect that bends in time over a recording, and how far at each sample; None where none does."""
    return next(
        (
            (key, courses[key].amplitude(place, part.size, part.size * part.dt))
            for key in effects
            if key in courses and courses[key].weights.size
        ),
        None,
    )


def _constant_columns(problem: LinearisedProblem) -> Floats:
    """Whitened change (N, t) of the simulation by each constant's spread, the loops held; by differences."""
    widest: dict[tuple[str, int | None], int] = {}
    for place, constant in enumerate(problem.constants):
        known = widest.get((constant.name, constant.part))
        if known is None or constant.spread * constant.straight > problem.constants[known].spread * (
            problem.constants[known].straight
        ):
            widest[constant.name, constant.part] = place

    def by_unit(place: int) -> Floats:
        """Change per unit of the constant."""
        constant = problem.constants[place]
        step = np.zeros(len(problem.constants))
        step[place] = STEP * constant.straight
        there = problem.responses({}, problem.origin + step, only=constant.part)
        return problem.stack(there) / (step[place] * constant.spread)

    columns = dict(zip(widest, parallel_map(by_unit, widest.values()), strict=True))
    return np.column_stack([c.spread * columns[c.name, c.part] for c in problem.constants])


def _loop_coupling(problem: LinearisedProblem) -> Floats:
    """Whitened change (N, t) of the loops that goes with each thermal parameter's step."""
    out = np.zeros((problem.weight.size, len(problem.constants)))
    simulation = problem.nominal.model.simulation.with_effects(problem.included)
    for row, part, response in problem.iterate():
        shape = problem.shapes.get(row.channel)
        for place, constant in enumerate(problem.constants):
            if shape is None or constant.drifts or constant.name not in shape.by_lag:
                continue
            weights = constant.spread * shape.by_lag[constant.name]
            change = shape.basis.fold(weights, span=shape.span)(response.temperature)[:, None]
            film = at_sensor(problem.nominal, row.channel, part, problem.included)
            out[row.where, place] = problem.whiten(
                row, as_sensed(simulation, row.channel, change, part.dt, film)[:, 0]
            )
    return out


def _moved(
    constants: Sequence[Constant], shift: Floats, parts: Sequence[Part], place: int | None = None
) -> dict[str, float]:
    """Values of the constants, each moved by all of its columns, as far as a device may be and the simulation can go.

    They are those of the recording at `place`, or what they are on average over the recordings.
    """
    before = {c.name: c.value for c in constants}
    moved = dict(before)
    for constant, z in zip(constants, shift, strict=True):
        weight = 1.0
        if constant.part is not None:
            weight = 1.0 / len(parts) if place is None else float(constant.part == place)
        moved[constant.name] += weight * constant.spread * float(z)
    if (lag := "thermal.time_constant") in moved:
        moved[lag] = max(moved[lag], QUICKEST * before[lag])
    if (delay := "driver.dead_time") in moved:
        latest = max(before[delay], LATEST * min(part.dt for part in parts))
        moved[delay] = min(max(moved[delay], 0.0), latest)
    return moved


def _possible(constants: Sequence[Constant], shift: Floats) -> Floats:
    """The move (t,) to linearise about, in which no dead time is below nothing.

    There the simulation would no longer change with it, and the nuisance model lose what a little earlier or later does.
    """
    found = np.array(shift, dtype=np.float64)
    own = [k for k, c in enumerate(constants) if c.name == "driver.dead_time"]
    if own:
        before = constants[own[0]].value
        total = before + sum(constants[k].spread * found[k] for k in own)
        if total < 0.0:
            found[own] *= before / (before - total)
    return found


def _reach(counts: NDArray[np.bool_], noise: NoiseModel) -> Floats:
    """1 where a sample and those its whitening needs are there, else 0."""
    good = counts.copy()
    for k, a in enumerate(noise.ar, 1):
        if a != 0.0:
            good[k:] &= counts[:-k]
    return good.astype(np.float64)


@dataclass(frozen=True)
class LoopColumns:
    """Columns of one channel's loop shape, before whitening.

    Attributes
    ----------
    directions : (m, k) weights of the basis that make the first k of them: what the data can tell, each a unit normal beforehand
    temperature : per recording, (n,) the path they were taken on [degC]
    raw : per recording, (n, k) in the channel's unit; (n, k + l) with the l parameters of a law that is fitted anew
    """

    directions: Floats
    temperature: tuple[Floats, ...]
    raw: tuple[Floats, ...]

    @property
    def shared(self) -> int:
        """Number k of columns that are of the basis."""
        return self.directions.shape[1]

    def fits(self, paths: Sequence[Floats]) -> bool:
        """Whether the columns are as good on other paths: they change over kelvins."""
        return len(paths) == len(self.temperature) and all(
            new.size == old.size and float(np.max(np.abs(new - old))) < STILL_K
            for new, old in zip(paths, self.temperature, strict=True)
        )


def _loop_columns(
    shapes: Mapping[str, LoopShape],
    rows: Sequence[Row],
    responses: Sequence[Response],
    nominal: Nominal,
    whitening: Sequence[Whitening],
    known: Mapping[str, LoopColumns],
    *,
    refits: bool,
) -> dict[str, LoopColumns]:
    """Columns of the loop shapes on these responses: few directions, each a unit normal beforehand."""
    most = MOST_REFITTED if refits else MOST
    present = [channel for channel in shapes if any(row.channel == channel for row in rows)]

    def columns(channel: str) -> LoopColumns:
        own = [row for row in rows if row.channel == channel]
        whiten = [w for row, w in zip(rows, whitening, strict=True) if row.channel == channel]
        paths = tuple(responses[row.part].temperature for row in own)
        before, shape = known.get(channel), shapes[channel]
        if before is not None and before.fits(paths):
            return before
        features = [shape.basis.features(path, span=shape.span) for path in paths]
        if before is not None:
            directions = before.directions
        else:
            gram = sum(_sampled_gram(w(f)) for f, w in zip(features, whiten, strict=True))
            directions = shape.main_directions(np.asarray(gram), most=most)
        raw = tuple(f @ directions for f in features)
        if refits:
            raw = tuple(
                np.hstack([columns, law_columns(nominal, channel, path)])
                for columns, path in zip(raw, paths, strict=True)
            )
        return LoopColumns(directions, paths, raw)

    return dict(zip(present, parallel_map(columns, present), strict=True))


def _whitened(
    loops: Mapping[str, LoopColumns],
    rows: Sequence[Row],
    parts: Sequence[Part],
    nominal: Nominal,
    effects: Effects,
    whitening: Sequence[Whitening],
) -> tuple[tuple[slice, Floats], ...]:
    """Whitened block of each channel, with its rows; what is open in the deflection's loop rings and creeps as all of it."""
    simulation = nominal.model.simulation.with_effects(effects)
    blocks = []
    for channel, columns in loops.items():
        own = [row for row in rows if row.channel == channel]
        whiten = [w for row, w in zip(rows, whitening, strict=True) if row.channel == channel]
        block = []
        for raw, row, w in zip(columns.raw, own, whiten, strict=True):
            part = parts[row.part]
            film = at_sensor(nominal, channel, part, effects)
            block.append(w(as_sensed(simulation, channel, raw, part.dt, film)))
        blocks.append((slice(own[0].where.start, own[-1].where.stop), np.concatenate(block)))
    return tuple(blocks)


def at_sensor(nominal: Nominal, channel: str, part: Part, effects: Effects) -> Floats | None:
    """Return what a sensor that effects have changed is given (n,), in judged units; None where that does not matter.

    Parameters
    ----------
    nominal : without the effects
    channel : of the sensor
    part : recording
    effects : that act
    """
    suffix = f":{channel}"
    acting = [key for key in effects if key.endswith(suffix)]
    straight = all(records()[key.removesuffix(suffix)].linear for key in acting)
    if not acting or (straight and channel != RESISTANCE):
        return None
    others = {key: values for key, values in effects.items() if key not in acting}
    return nominal.respond(part.current, part.dt, effects=others, settled=part.settled).channels[channel]


def _sampled_gram(block: Floats, sample: int = 6000) -> Floats:
    stride = max(1, block.shape[0] // sample)
    some = block[::stride]
    return np.asarray(some.T @ some * float(stride))
