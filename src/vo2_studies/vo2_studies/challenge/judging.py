"""One diagnosis against its answer: every rule of the scoring, one function each.

Names. The *named* effects are the ids in `effects`, "unknown" excluded. The *ranking* is `effects` in order, then
`candidates` by falling probability, without repetition.

An answer that states a limit counts as right (`states_limit`) in two cases only:

1. the effect is absorbed by a constant (a laser that is on throughout): the verdict is "differs" and the diagnosis
   mentions the true effect in an `indistinguishable` pair, in `not_excited`, or in `limits`;
2. the effect needs a channel that the rig does not have (`NEEDS_CHANNEL`): the verdict is "differs", the true
   effect is in an `indistinguishable` pair, and `next_experiment` is "manual" and separates it.

Families. An effect's family is right where it is one of the answer's `families`: the contract's, then those that say as
much (a film that changes and its ohmmeter that errs are one thing in one channel). An answer without `family` has that
of the name it gives.

A pair reported as separable by another *excitation* does not count as right by itself; it is counted apart, and
scored again after the proposed experiment (`follow_up`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from vo2_models.recording import HEATER_CURRENT

from vo2_studies.challenge.catalogue import family_of_name
from vo2_studies.challenge.constants import names_constant
from vo2_studies.challenge.parameters import Z90, Comparison, compare_parameters, in_base_unit

__all__ = [
    "COUNTED_EXCESS",
    "FAILED",
    "NEEDS_CHANNEL",
    "NONE",
    "Judgement",
    "excess_removed",
    "judge",
    "named",
    "ranking",
    "states_limit",
]

COUNTED_EXCESS = 10.0
"""Effects below this excess (in units of the noise power) are scored apart."""
NEEDS_CHANNEL = {
    "heater_tcr": "heater_voltage",
    "nonlinear_heat_loss": "ambient_temperature",
    "sense_self_heating": "sense_current",
    "laser_heating": "laser_on",
}
"""Effects that another channel separates, and the channel."""
NONE, FAILED, LIMIT = "none", "failed", "limit stated"
SETTINGS = {"hysteresis": "family", "condition": "condition", "excitation": "excitation", "device": "device"}
"""Heading under which figures are split -> its key in an answer."""
VERDICTS = {"none": ("agrees",), "day": ("agrees", "drifted"), "moved": ("drifted",)}
"""Kind of case -> right verdicts; "differs" for all others."""
_ONE = ("top1", "top3", "sibling", "family", "channel", "told")
ASKED = {
    "none": (),
    "day": (),
    "moved": ("constant",),
    "one": _ONE,
    "always": _ONE,
    "beside": (*_ONE, "constant"),
    "two": ("both", "either", "extra"),
    "outside": ("unknown", "family", "channel"),
}
"""Kind of case -> questions that a case without diagnosis gets wrong."""


@dataclass(frozen=True)
class Judgement:
    """The outcome of one case; None where a question does not arise.

    Attributes
    ----------
    index, kind, device, truth : of the answer; `truth` the effect ids
    settings : what the case was drawn under: hysteresis (its family), condition, excitation, rig
    counted : whether the excess of every effect exceeds `COUNTED_EXCESS` (cases without effect: True)
    failure : reason why there is no diagnosis, or ""
    first : row label of the confusion matrix: id named first, "unknown", "none", "limit stated" or "failed"
    verdict : whether the verdict is right: agrees, on another day drifted too; drifted; differs
    alarm : verdict "differs" or any effect named
    wrong : a name that is not the truth's, nor of a form that it says as much of; or a set of effects without the truth
    family : the first effect's family is right (one effect or outside)
    constant : drifted, and the constant that moved farthest in its standard deviations is the right one
    constant_held : the 90 per cent interval of the moved constant, told, holds the truth (factors and kelvins)
    top1, top3 : right name first, among the first three of the ranking (one effect)
    sibling : right name first, or among the siblings of what is named first (one effect)
    limit : right because the limit was stated
    both, either, extra : two effects: both named, at least one named, a wrong name besides
    unknown : outside the catalogue: "unknown" first and no catalogue name
    removed : share of excess residual removed on held-out data
    channel, branch, frequency, signal : location right; right sensor named
    told : right name first, or told to be inseparable from another or not excited (one effect)
    parameters : comparison of the parameters where the effect was named
    experiment : kind of next experiment that separates the truth from an indistinguishable rival, or ""
    after_experiment : right name first after that experiment
    stated : (probability, whether true) of every effect that the diagnosis lists
    seconds : wall time of the diagnosis
    """

    kind: str
    device: str
    truth: tuple[str, ...]
    counted: bool
    failure: str
    first: str
    alarm: bool
    index: int = -1
    settings: Mapping[str, str] = field(default_factory=dict)
    verdict: bool = False
    wrong: bool = False
    family: bool | None = None
    constant: bool | None = None
    constant_held: bool | None = None
    sibling: bool | None = None
    stated: tuple[tuple[float, bool], ...] = ()
    top1: bool | None = None
    top3: bool | None = None
    limit: bool = False
    both: bool | None = None
    either: bool | None = None
    extra: bool | None = None
    unknown: bool | None = None
    removed: float | None = None
    channel: bool | None = None
    branch: bool | None = None
    frequency: bool | None = None
    signal: bool | None = None
    told: bool | None = None
    parameters: Comparison | None = None
    experiment: str = ""
    after_experiment: bool | None = None
    seconds: float | None = None


def named(diagnosis: Mapping) -> list[str]:
    """Return the ids of the effects, "unknown" excluded, in order."""
    return [entry["id"] for entry in diagnosis["effects"] if entry["id"] != "unknown"]


def ranking(diagnosis: Mapping) -> list[str]:
    """Return effects in order, then candidates by falling probability, each id once."""
    candidates = sorted(diagnosis["candidates"], key=lambda entry: -entry["probability"])
    ids = [entry["id"] for entry in (*diagnosis["effects"], *candidates)]
    return list(dict.fromkeys(ids))


def _paired(diagnosis: Mapping) -> set[str]:
    return {name for pair in diagnosis["indistinguishable"] for name in pair}


def states_limit(effect: Mapping, diagnosis: Mapping) -> bool:
    """Whether the diagnosis states the limit that the effect imposes (rules 1 and 2 above)."""
    if diagnosis["verdict"] != "differs":
        return False
    name = effect["id"]
    if effect["absorbed_by_constant"]:
        mentioned = name in _paired(diagnosis) or name in diagnosis.get("not_excited", ())
        return mentioned or any(name in text for text in diagnosis.get("limits", ()))
    experiment = diagnosis["next_experiment"]
    return (
        name in NEEDS_CHANNEL
        and name in _paired(diagnosis)
        and experiment is not None
        and experiment["kind"] == "manual"
        and name in experiment["separates"]
    )


def excess_removed(diagnosis: Mapping) -> float | None:
    """Return the share of excess residual energy removed on held-out data, None where there was none.

    1 - sum(after^2 - floor^2) / sum(before^2 - floor^2) over channels, each in units of its floor^2, negative
    differences counted as zero.
    """
    before = after = 0.0
    for fit in diagnosis["fit"].values():
        floor = float(fit["noise_floor"])
        if floor <= 0:
            continue
        before += max((fit["nrmse_before"] / floor) ** 2 - 1, 0.0)
        after += max((fit["nrmse_after"] / floor) ** 2 - 1, 0.0)
    return 1 - after / before if before > 0 else None


def _top_location(diagnosis: Mapping, *, drive: bool = True) -> Mapping | None:
    """Return the entry with the largest share; without `drive` of what the device does, not of its current."""
    entries = [entry for entry in diagnosis["location"] if drive or entry["signal"] != HEATER_CURRENT]
    return max(entries, key=lambda entry: entry["share"]) if entries else None


def _frequency(effect: Mapping, diagnosis: Mapping) -> bool:
    """Whether the resonance's frequency is within 5 per cent: as a parameter in hertz, or as the located band's middle."""
    true = effect["parameters"]["frequency"]["value"]
    found = []
    for entry in diagnosis["effects"]:
        if entry["id"] == effect["id"]:
            for parameter in entry["parameters"].values():
                unit, factor = in_base_unit(parameter["unit"])
                if unit == "Hz":
                    found.append(parameter["value"] * factor)
    top = _top_location(diagnosis)
    if top is not None:
        low, high = top["frequency_hz"]
        found.append(float(np.sqrt(low * high)) if low > 0 else (low + high) / 2)
    return any(abs(value - true) <= 0.05 * true for value in found)


def _first(answer: Mapping, diagnosis: Mapping) -> str:
    first = str(diagnosis["effects"][0]["id"]) if diagnosis["effects"] else ""
    truth = [effect["id"] for effect in answer["effects"]]
    if first not in truth and any(states_limit(effect, diagnosis) for effect in answer["effects"]):
        return LIMIT
    if first:
        return first
    return "unknown" if diagnosis["verdict"] == "differs" else NONE


def judge(answer: Mapping, result: Mapping) -> Judgement:
    """Return the judgement of one case.

    Parameters
    ----------
    answer : the concealed truth
    result : {"failure": text, "seconds": x, "diagnosis": diagnosis or None, "follow_up": diagnosis or None}

    A case without diagnosis (crash, timeout, invalid file) is wrong in every question that its kind raises.
    """
    effects = answer["effects"]
    truth = tuple(effect["id"] for effect in effects)
    kind = answer["kind"]
    diagnosis = result.get("diagnosis")
    base: dict[str, Any] = {
        "index": answer.get("index", -1),
        "kind": kind,
        "device": answer["device"],
        "truth": truth,
        "counted": answer.get(
            "counted", all(effect.get("excess", 0.0) > COUNTED_EXCESS for effect in effects)
        ),
        "settings": {key: answer[name] for key, name in SETTINGS.items() if name in answer},
    }
    if diagnosis is None:
        reason = str(result.get("failure") or "no diagnosis")
        base |= dict.fromkeys(ASKED[kind], False)
        return Judgement(**base, failure=reason, first=FAILED, alarm=False)
    names = named(diagnosis)
    right_names = {*truth, *(name for effect in effects for name in effect.get("siblings", ()))}
    values: dict = {
        "failure": "",
        "first": _first(answer, diagnosis),
        "verdict": diagnosis["verdict"] in VERDICTS.get(kind, ("differs",)),
        "alarm": diagnosis["verdict"] == "differs" or bool(diagnosis["effects"]),
        "wrong": bool(set(names) - right_names) or _wrong_set(diagnosis, right_names),
        "stated": _stated(diagnosis, right_names, kind),
        "seconds": result.get("seconds"),
    }
    if answer.get("moved"):
        values["constant"] = _right_constant(answer, diagnosis)
        values["constant_held"] = _holds_constant(answer["moved"][0], diagnosis)
    if kind in ("one", "always", "beside"):
        values |= _judge_one(effects[0], diagnosis)
        follow_up = result.get("follow_up")
        if follow_up is not None and values["experiment"] == "excitation":
            first = follow_up["effects"][0]["id"] if follow_up["effects"] else ""
            values["after_experiment"] = first == truth[0]
    elif kind == "two":
        right = [effect["id"] in names or states_limit(effect, diagnosis) for effect in effects]
        values |= {"both": all(right), "either": any(right), "extra": values["wrong"]}
        values["removed"] = excess_removed(diagnosis)
    elif kind == "outside":
        top = _top_location(diagnosis)
        values["unknown"] = values["first"] == "unknown" and not names and not values["wrong"]
        values["family"] = _right_family(effects[0], diagnosis)
        values["removed"] = excess_removed(diagnosis)
        values["channel"] = top is not None and top["signal"] in effects[0]["channels"]
    return Judgement(**base, **values)


def _wrong_set(diagnosis: Mapping, right: set[str]) -> bool:
    """Whether "unknown" is told to be one of several effects, none of which is right: that is a wrong answer too."""
    sets = [set(e.get("siblings", ())) for e in diagnosis["effects"] if e["id"] == "unknown"]
    return any(one and not one & right for one in sets)


def _stated(diagnosis: Mapping, right: set[str], kind: str) -> tuple[tuple[float, bool], ...]:
    """Return probability and truth of every listed effect; "unknown" is true of what is outside the catalogue."""
    true = right | ({"unknown"} if kind == "outside" else set())

    def holds(entry: Mapping) -> bool:
        told = entry.get("siblings") if entry["id"] == "unknown" else None
        return bool(set(told) & right) if told else entry["id"] in true

    return tuple((float(entry["probability"]), holds(entry)) for entry in diagnosis["effects"])


def _right_constant(answer: Mapping, diagnosis: Mapping) -> bool:
    """Whether the constant that moved farthest, in its standard deviations, is the one that was moved."""
    entries = diagnosis.get("moved") or ()
    if not entries or (answer["kind"] == "moved" and diagnosis["verdict"] != "drifted"):
        return False
    farthest = max(entries, key=lambda e: abs(e["is"] - e["was"]) / (e.get("std") or 1.0))
    return names_constant(answer["moved"][0]["constant"], farthest)


def _holds_constant(truth: Mapping, diagnosis: Mapping) -> bool | None:
    """Whether the 90 per cent interval of the moved constant holds the truth; None where it is not told, or in no common unit.

    A factor is one of the calibrated value; of a zero the truth is a share of the drawn device's range.
    """
    entries = diagnosis.get("moved") or ()
    told = next((e for e in entries if names_constant(truth["constant"], e) and e.get("std")), None)
    if told is None or truth["unit"] not in ("1", "K"):
        return None
    size = told["was"] if truth["unit"] == "1" else 1.0
    return bool(abs(told["is"] - told["was"] - truth["by"] * size) <= Z90 * told["std"])


def _right_family(effect: Mapping, diagnosis: Mapping) -> bool:
    """Whether the first effect's family is one of the answer's; see the module."""
    if not diagnosis["effects"]:
        return False
    entry = diagnosis["effects"][0]
    family = entry.get("family") or family_of_name(entry["id"], entry.get("signal"))
    return family in effect.get("families", ())


def _judge_one(effect: Mapping, diagnosis: Mapping) -> dict:
    """Return the fields of a one-effect case."""
    name = effect["id"]
    effects = diagnosis["effects"]
    limit = states_limit(effect, diagnosis)
    first = bool(effects) and effects[0]["id"] in (name, *effect.get("siblings", ()))
    top = _top_location(diagnosis)
    values: dict = {
        "family": _right_family(effect, diagnosis),
        "sibling": first or limit or (bool(effects) and name in effects[0].get("siblings", ())),
        "top1": first or limit,
        "top3": limit or (diagnosis["verdict"] == "differs" and name in ranking(diagnosis)[:3]),
        "limit": limit and not first,
        "removed": excess_removed(diagnosis),
        "channel": top is not None and top["signal"] in effect["channels"],
        "told": first or limit or name in _paired(diagnosis) or name in diagnosis.get("not_excited", ()),
        "experiment": "",
    }
    if effect["branch"] != "both":
        # the truth is told of what the device does: the logged current has the branch of the command
        place = _top_location(diagnosis, drive=False)
        values["branch"] = place is not None and place["branch"] == effect["branch"]
    if name == "cantilever_resonance":
        values["frequency"] = _frequency(effect, diagnosis)
    for entry in effects:
        if entry["id"] == name:
            values["parameters"] = compare_parameters(name, effect["parameters"], entry["parameters"])
            if effect["signal"] is not None:
                values["signal"] = entry.get("signal") == effect["signal"]
            break
    experiment = diagnosis["next_experiment"]
    if experiment is not None and name in experiment["separates"] and name in _paired(diagnosis):
        values["experiment"] = experiment["kind"]
    return values
