"""Cases of measured devices: a third unchanged, the rest with one change of 1 to 100 times the repeats' distance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from vo2_models.recording import Recording

from vo2_studies.challenge.draw import Case, Recorded
from vo2_studies.challenge.effect import log_uniform
from vo2_studies.challenge.plan import CasePlan
from vo2_studies.challenge.recordings.changes import CHANGES, Change, changed
from vo2_studies.challenge.recordings.sets import Array, MeasuredSet, judged, load_sets

__all__ = ["MeasuredSettings", "answer_of", "conceal"]

RATIOS = (1.0, 100.0)
"""Size of a change over the repeats' distance."""
COUNTED_RATIO = 5.0
"""Smaller changes are scored apart."""
REMOUNTED = "remounted"


@dataclass(frozen=True)
class MeasuredSettings:
    """What decides the cases; the same interface as `runner.Settings`."""

    seed: int
    recordings: str
    only: tuple[str, ...] = ()

    @cached_property
    def sets(self) -> list[MeasuredSet]:
        found = load_sets(Path(self.recordings))
        names = [one.name for one in found]
        if unknown := sorted(set(self.only) - set(names)):
            raise ValueError(f"sets: found {', '.join(unknown)}, need some of {', '.join(names)}")
        return [one for one in found if not self.only or one.name in self.only]

    def plan(self, index: int) -> CasePlan:
        """Return the plan of case `index`: sets in turn, every third case unchanged, changes in shuffled decks."""
        number, place = divmod(index, len(self.sets))
        measured = self.sets[place]
        parts = list(measured.others)
        part = parts[number % len(parts)]
        kind = "one"
        if (number + place) % 3 == 0:
            kind = "day" if part == REMOUNTED else "none"
        usable = [c for c in CHANGES if not c.units or measured.unit in c.units]
        deck, card = divmod(number, len(usable))
        order = np.random.default_rng([self.seed, 71, place, deck]).permutation(len(usable))
        effects = (usable[int(order[card])].id,) if kind == "one" else ()
        return CasePlan(
            index, kind, measured.name, effects, family="measured", condition=part, excitation="own"
        )

    def case(self, plan: CasePlan) -> Case:
        """Draw the case of `plan`."""
        (measured,) = (one for one in self.sets if one.name == plan.device)
        rng = np.random.default_rng([self.seed, 73, plan.index])
        test, entries = measured.others[plan.condition], []
        if plan.effects:
            (change,) = (one for one in CHANGES if one.id == plan.effects[0])
            test, entry = conceal(measured, test, change, log_uniform(rng, *RATIOS))
            entries.append(entry)
        answer = answer_of(plan, measured, entries, [], counted_ratio=COUNTED_RATIO)
        return Case(
            plan,
            None,
            Recorded(measured.calibration, None),
            Recorded(test, None),
            answer,
            measured.document,
            shared=measured.name,
        )


def answer_of(
    plan: CasePlan, measured: MeasuredSet, effects: list[dict], moved: list[dict], *, counted_ratio: float
) -> dict:
    """Return the answer of a case: what was concealed, and whether it is scored with the others.

    Parameters
    ----------
    plan, measured : the case and its device
    effects, moved : entries of the changes and of the constants that have moved
    counted_ratio : a change of up to so many spreads of repeats is scored apart
    """
    return {
        "index": plan.index,
        "kind": plan.kind,
        "device": plan.device,
        "family": plan.family,
        "condition": plan.condition,
        "excitation": plan.excitation,
        "repeat_spread": measured.spread,
        "moved": moved,
        "effects": effects,
        "counted": all(entry["ratio"] > counted_ratio for entry in effects),
    }


def conceal(measured: MeasuredSet, test: Recording, change: Change, ratio: float) -> tuple[Recording, dict]:
    """Return the recording with the change, and what the answer says of it.

    Parameters
    ----------
    measured : the device
    test : recording of it
    change : what is done to its response or its drive
    ratio : wanted size, r.m.s., over the device's `spread`
    """
    channel = measured.drive if change.before else measured.response
    values = test[channel]
    before = values if change.before else judged(values, measured.unit)
    # a drive moves by the share of its range that the response is to move of its own
    scale = np.ptp(values) / np.ptp(judged(test[measured.response], measured.unit)) if change.before else 1.0

    def moved(after: Array) -> float:
        return float(
            np.sqrt(np.mean(((after if change.before else judged(after, measured.unit)) - before) ** 2))
        )

    unit = measured.spread * float(scale)
    after, strength = changed(change, test.time_s, values, ratio * unit, moved)
    family = f"{change.family}:{channel}" if change.family in ("sensor", "clock") else change.family
    # a single response does not tell a structure that lags from its sensor
    also = [f"sensor:{channel}"] if change.family in ("structure", "film") else []
    entry = {
        "id": change.id,
        "form": "measured",
        "siblings": [],
        "families": [family, *also],
        "signal": channel if change.family in ("sensor", "clock") else None,
        "parameters": {
            change.parameter: {
                "value": strength,
                "unit": measured.unit if change.unit == "response" else change.unit,
            },
            **{n: {"value": v, "unit": u} for n, (v, u) in change.fixed(test.sample_period_s).items()},
        },
        "ratio": moved(after) / unit,
        "channels": [channel, measured.response],
        "branch": "both",
        "absorbed_by_constant": False,
    }
    return replace(test, channels={**test.channels, channel: np.asarray(after, dtype=np.float64)}), entry
