"""The corrected model: named effects, moved constants, refitted loops, and terms that stand for what has no name.

What has no name is still something that the device model must carry, so that plant, predict and estimator run it. It is
written as those effects of the catalogue that come nearest to it. They describe; they are not what the device has.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.drift import drift_of
from vo2_models.diagnosis.held_out import HeldOut, block_folds, held_out
from vo2_models.diagnosis.nominal import THERMAL, Nominal
from vo2_models.diagnosis.nuisance import Constant
from vo2_models.diagnosis.pairs import Option, option_of, pair_of
from vo2_models.diagnosis.problem import LinearisedProblem
from vo2_models.diagnosis.stages import Study
from vo2_models.effects import effects as records
from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.laws import scaled_law
from vo2_models.identification.bank_fit import BankShape, evaluate, fit_bank
from vo2_models.identification.loops_fit import COLD
from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = ["CorrectedModel", "StandIn", "corrected_model", "distance", "stand_in"]

Floats = NDArray[np.float64]
_NEAR_THE_END, _FROM_REST = 0.05, 200
"""Share of the judged temperatures that counts as their end, and samples of the way from rest to them."""
PROMISING = 3
"""Single effects that are tried as a description."""


@dataclass(frozen=True)
class StandIn:
    """Terms of the catalogue that stand for what has no name.

    Attributes
    ----------
    option : the terms, and the problem about them
    judged : how they do on blocks that they were not fitted on
    """

    option: Option
    judged: HeldOut

    def in_words(self) -> str:
        """One sentence for a reader of the answer."""
        names = " and ".join(self.option.chosen.keys)
        share = min(self.judged.share, 1.0)  # by chance they may leave less than noise
        return (
            f"corrected_model.yaml carries what has no name by the terms that come nearest, {names}: on blocks that they "
            f"were not fitted on they remove {100 * share:.0f} % of the excess; they describe, and name nothing"
        )


@dataclass(frozen=True)
class CorrectedModel:
    """What is written down.

    Attributes
    ----------
    parameters : of the model file
    unnamed : terms in it that stand for what has no name; None for none
    nrmse : channel -> root mean square of what it leaves of the recordings, over the channel's range
    impossible : why the constants of the calibration are in it in place of those that were found; empty where these are
    """

    parameters: Mapping[str, Value]
    unnamed: StandIn | None
    nrmse: Mapping[str, float]
    impossible: str = ""


@dataclass(frozen=True)
class _Written:
    """What may be written down.

    Attributes
    ----------
    parameters : of the model file; a constant that is another one in each recording has their mean
    apart : constant -> how far it is from that mean, of each recording; empty where none is
    impossible : as of `CorrectedModel`
    """

    parameters: Mapping[str, Value]
    apart: tuple[Mapping[str, float], ...] = ()
    impossible: str = ""

    def of_part(self, place: int) -> Mapping[str, float]:
        """Return what a recording differs by from the file."""
        return self.apart[place] if self.apart else {}


def stand_in(study: Study) -> StandIn | None:
    """Return the terms that come nearest to what has no name; None where everything has one, or no term is near.

    One or two effects, by held-out blocks: what the search has refitted, and a second beside the best that need not be one
    which could be named.

    Parameters
    ----------
    study : of the recordings, as `study` returns it
    """
    located, found = study.located, study.search
    if study.decision.verdict != "differs" or study.decision.chosen is not None or not found.singles:
        return None
    problem = located.problem
    options = list(found.options)
    if not options:
        options = [
            option_of(located.nominal, problem, single, found.singles, study.limits)
            for single in found.singles[:PROMISING]
        ]
    alone = min((o for o in options if len(o.chosen.keys) == 1), key=_left, default=None)
    if alone is not None and all(len(o.chosen.keys) == 1 for o in options):
        anything = replace(study.limits, second_cosine=1.0)
        pair = pair_of(located.nominal, problem, alone, found.candidates, anything)
        options += [pair] if pair else []
    folds = block_folds(problem)
    tried = [
        StandIn(option, held_out(option.final, option.chosen, study.limits, reference=problem, folds=folds))
        for option in sorted(options, key=_left)[:2]
    ]
    best = max(tried, key=lambda one: one.judged.share)
    return best if best.judged.share > study.limits.worth else None


def corrected_model(study: Study) -> CorrectedModel:
    """Return the model with effects and moved constants, and what else brings it nearer to the recordings.

    What a diagnosis leaves, it leaves beside loops that it lets change a little, and beside constants that are not told. A
    file does not hold all that. Written down are effects and told constants; with those that the fit moved beside them, or
    with loops fitted anew as well, where that is nearer to the recordings. Terms for what has no name are written down only
    where they bring the model nearer.

    Parameters
    ----------
    study : what was found
    """
    as_it_is = dict(study.located.nominal.parameters)
    if study.verdict == "agrees":
        return CorrectedModel(as_it_is, None, _judged(study, _Written(as_it_is))[1])
    unnamed = stand_in(study)
    if unnamed is not None:
        written, nrmse = _nearest(study, [_Written(as_it_is), *_written(study, unnamed)])
        if written.parameters is not as_it_is:
            return CorrectedModel(written.parameters, unnamed, nrmse, written.impossible)
    # what is told is in the file, however little of the residual it is
    written, nrmse = _nearest(study, _written(study, None))
    return CorrectedModel(written.parameters, None, nrmse, written.impossible)


def distance(study: Study) -> float:
    """Return how far the corrected model is from the recordings, over how far the model is as it is (r.m.s. in noise levels).

    Where the whole nominal device is fitted anew, its loops and an effect may each make up for what the other does. Then no model
    that holds the effect comes near the recordings, and what was fitted together is a coincidence and not physics.

    Parameters
    ----------
    study : with a decision that names something
    """
    as_it_is = _judged(study, _Written(study.located.nominal.parameters))[0]
    corrected = min(_judged(study, written)[0] for written in _written(study, None))
    return float(np.sqrt(corrected / max(as_it_is, 1e-300)))


def _nearest(study: Study, candidates: Iterable[_Written]) -> tuple[_Written, dict[str, float]]:
    """The first of the candidates, or a later one that leaves clearly less; with what it leaves of each channel."""
    best = _Written({})
    least, nrmse = np.inf, dict[str, float]()
    for written in candidates:
        square, left = _judged(study, written)
        if not best.parameters or square < (1.0 - study.limits.worth) * least:
            best, least, nrmse = written, square, left
    return best, nrmse


def _judged(study: Study, written: _Written) -> tuple[float, dict[str, float]]:
    """Squared residual of the recordings over their noise, and of each channel the root mean square over its range."""
    nominal = study.located.nominal
    left = {c: np.concatenate(parts) for c, parts in _residual(study, written).items()}
    total = sum(float(gap @ gap) / nominal.noise[c].level ** 2 for c, gap in left.items())
    return total, {
        c: float(np.sqrt(np.mean(gap**2))) / nominal.span[c] for c, gap in left.items() if gap.size
    }


def _off(study: Study, written: _Written) -> dict[str, float]:
    """Return by how much what is measured lies above a model in the middle, by section of the law, in the law's unit."""
    signs = {RESISTANCE: ("resistance", -1.0), TIP_DEFLECTION: ("deflection", 1.0)}
    return {
        signs[c][0]: signs[c][1] * float(np.median(np.concatenate(parts)))
        for c, parts in _residual(study, written).items()
        if c in signs
    }


def _residual(study: Study, written: _Written) -> dict[str, list[Floats]]:
    """Measured minus simulated values of each channel, recording by recording, where there are some."""
    problem = study.located.problem
    nominal = Nominal.from_parameters(written.parameters)
    # periodic interference was taken out of what is compared
    kept = {
        k: v for k, v in nominal.model.effects.items() if "line" not in records()[k.partition(":")[0]].hooks
    }
    nominal = replace(nominal, model=replace(nominal.model, effects=kept), corrections={})
    responses = [
        nominal.respond(
            part.current,
            part.dt,
            settled=part.settled,
            constants={n: nominal.model.scalars.get(n, 0.0) + d for n, d in written.of_part(place).items()},
        )
        for place, part in enumerate(problem.parts)
    ]
    left: dict[str, list[Floats]] = {}
    for row in problem.rows:
        part = problem.parts[row.part]
        valid = part.valid[row.channel]
        gap = (part.observed[row.channel] - responses[row.part].channels[row.channel])[valid]
        left.setdefault(row.channel, []).append(gap)
    return left


def _written(study: Study, unnamed: StandIn | None) -> Iterator[_Written]:
    """Parameters with what was found, and what else may be beside it."""
    flat, decision = dict(study.located.nominal.parameters), study.decision
    final, chosen = decision.final, decision.chosen
    if unnamed is not None:
        final, chosen = unnamed.option.final, unnamed.option.chosen
    model = study.located.nominal.model
    shown = {key: values for evident in study.reading.evident for key, values in evident.effects.items()}
    rest = final.residual - chosen.deviation if chosen else final.residual
    added = {**model.effects, **(chosen.effects if chosen else {}), **shown}

    def with_constants(bases: Mapping[str, Value], moves: Floats, laws: Mapping[str, Law]) -> _Written:
        try:
            found = moved_by(bases, moves, laws)
            Nominal.from_parameters(found.parameters)
            return found
        except ValueError as error:  # constants that no device has: the calibrated ones stay
            kept = replace(model, effects=added, deflection=laws["deflection"], resistance=laws["resistance"])
            return _Written({**bases, **kept.to_parameters()}, impossible=str(error))

    def moved_by(bases: Mapping[str, Value], moves: Floats, laws: Mapping[str, Law]) -> _Written:
        values = final.moved(moves)
        own = [final.moved(moves, place) for place in range(len(final.parts))]
        apart = {c.name for c in final.constants if c.part is not None}
        zero, gain = values.get("deflection.zero", 0.0), values.get("deflection.gain", 1.0)
        moved = replace(
            model,
            effects=added,
            scalars={**model.scalars, **{name: values[name] for name in THERMAL if name in values}},
            deflection=_scaled(laws["deflection"], gain, zero),
            # the law is that of -log10 R, the constant 1 + ln gain
            resistance=_scaled(
                laws["resistance"], 1.0, (1.0 - values.get("resistance.gain", 1.0)) / np.log(10.0)
            ),
        )
        return _Written(
            {**bases, **moved.to_parameters()},
            tuple({name: each[name] - values[name] for name in apart} for each in own),
        )

    laws = {"resistance": model.resistance, "deflection": model.deflection}
    together = drift_of(final, rest).weights
    # where the whole nominal device is fitted anew, or effects only stand in, all constants belong to the fit
    if not final.refits and unnamed is None:
        told = _told(study)
        only = np.array([c in told for c in final.constants])
        moves = _moves(study, rest, told)
        yield with_constants(flat, np.where(only, moves, 0.0), laws)
        yield with_constants(flat, moves, laws)
    else:
        yield with_constants(flat, together, laws)
    # what the calibration left over was left over by the loops as they were
    bare = {name: value for name, value in flat.items() if not name.startswith("model.enrichment.")}
    refitted = _refitted(final, rest, laws)
    if refitted:
        # a creep that is slower than the recordings goes on from where each begins: that shifts all of a loop
        off = _off(study, with_constants(bare, together, laws | refitted))
        centred = {section: scaled_law(law, 1.0, off.get(section, 0.0)) for section, law in refitted.items()}
        yield with_constants(bare, together, laws | centred)


def _told(study: Study) -> tuple[Constant, ...]:
    """The constants that are told to have moved."""
    drift, limits = study.decision.drift, study.limits
    return (
        drift.fewest(limits.drift_p, limits.rival)[0].constants if drift.significant(limits.drift_p) else ()
    )


def _moves(study: Study, rest: Floats, told: tuple[Constant, ...]) -> Floats:
    """Moves (t,) of the constants that a residual (N,) leads to: of those that drift, the ones that are told alone.

    Free together they trade, and on another path what one takes from another does not cancel.
    """
    final = study.decision.final
    free = [not c.drifts or c in told for c in final.constants]
    nuisance = replace(final.nuisance, thermal=final.nuisance.thermal * free)
    return drift_of(replace(final, nuisance=nuisance), rest).weights


def _left(option: Option) -> float:
    """Chi-square that an option leaves."""
    return option.chosen.chi_square


def _refitted(final: LinearisedProblem, rest: Floats, laws: Mapping[str, Law]) -> dict[str, Law]:
    """The loops that were fitted along with an effect, as laws of a model file.

    What the nuisance model made of them is a law plus a correction on known paths of temperature; a law is fitted to both.
    Beyond the temperatures that are judged the correction goes on as at their ends, down to rest, where a run begins.
    """
    weights = final.loop_weights(final.fit_nuisance(rest))
    ambient = final.nominal.model.scalars["thermal.ambient"]
    found: dict[str, Law] = {}
    for channel, columns in final.loops.items():
        section, sign = ("resistance", -1.0) if channel == RESISTANCE else ("deflection", 1.0)
        try:
            start = BankShape.of_bank(laws[section])
        except ValueError:  # no law that a fit wrote: it stays
            continue
        temperature = np.concatenate(columns.temperature)
        change = sign * np.concatenate([raw @ weights[channel] for raw in columns.raw])
        judged = (
            np.concatenate([final.weight[row.where] for row in final.rows if row.channel == channel]) > 0.0
        )
        if not judged.any():
            continue
        low, high = np.min(temperature[judged]), np.max(temperature[judged])
        near = _NEAR_THE_END * (high - low)
        at_low, at_high = (
            float(np.median(change[judged & at_end]))
            for at_end in (temperature <= low + near, temperature >= high - near)
        )
        change = np.where(temperature < low, at_low, np.where(temperature > high, at_high, change))
        parts = np.split(change, np.cumsum([part.size for part in columns.temperature])[:-1])
        paths = [*map(_cold, columns.temperature), _cold(np.linspace(min(ambient, low), low, _FROM_REST))]
        changes = [*parts, np.full(_FROM_REST, at_low)]
        path = np.concatenate(paths)
        target = np.concatenate(
            [
                np.concatenate([[np.nan], evaluate(start, one)[0][1:] + by])
                for one, by in zip(paths, changes, strict=True)
            ]
        )
        if np.count_nonzero(np.isfinite(target)) >= 2 * start.vector.size:
            found[section] = fit_bank(path, target, start, iterations=30).shape.bank()
    return found


def _cold(path: Floats) -> Floats:
    """A path of temperature (n,) [degC] with a cold sample before, which brings every play to its cold end."""
    return np.concatenate([[COLD], path])


def _scaled(law: Law, gain: float, zero: float) -> Law:
    """The law gain y + zero, zero in the output's unit."""
    return scaled_law(law, gain, zero) if law.present else law
