"""From judged cases to `challenge.json`: the contract's keys, Wilson intervals, and what stands behind them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from vo2_studies.challenge.judging import COUNTED_EXCESS, Judgement

__all__ = ["score", "wilson"]


def wilson(right: int, count: int, z: float = 1.959964) -> list[float] | None:
    """Return the Wilson score interval [low, high] of a rate `right` / `count`; None where `count` is 0.

    Wilson, J. Am. Stat. Assoc. 22, 209, 1927; `z` 1.96 for 95 per cent.
    """
    if count == 0:
        return None
    rate, weight = right / count, z * z / count
    middle = (rate + weight / 2) / (1 + weight)
    half = z / (1 + weight) * np.sqrt(rate * (1 - rate) / count + weight / (4 * count))
    return [max(0.0, float(middle - half)), min(1.0, float(middle + half))]


def _rate(answers: Iterable[bool | None]) -> tuple[float | None, list[float] | None, int]:
    """Return rate, Wilson interval and count of the answers that are not None."""
    known = [bool(answer) for answer in answers if answer is not None]
    if not known:
        return None, None, 0
    return sum(known) / len(known), wilson(sum(known), len(known)), len(known)


def _median(values: Iterable[float | None]) -> float | None:
    known = [float(value) for value in values if value is not None]
    return float(np.median(known)) if known else None


def score(judgements: Sequence[Judgement]) -> dict[str, Any]:
    """Return the content of `challenge.json`.

    Keys of the contract
    --------------------
    cases : judged cases
    false_alarm : of the cases without effect, those with verdict "differs" or any effect named
    top1, top3 : one effect, excess over 10 noise powers: right name first / among the first three of the ranking,
        a rightly stated limit included; the mean over effects of each effect's rate (`*_pooled` over cases)
    pair_exact : two effects, both over 10: both named; `pair_any` at least one; `pair_extra` a wrong name besides
        (`pair_exact_alone`: both and nothing else)
    outside_unknown : outside the catalogue, over 10: "unknown" first and no catalogue name
    outside_excess_removed, excess_removed : median share of the excess residual removed on held-out data, of the
        cases outside the catalogue and of those with one effect
    parameter_error : median relative error of the matched parameters of rightly named effects
    coverage90 : share of these whose interval value +- 1.645 std holds the truth
    channel : one effect or outside: the channel of the largest share of excess carries at least a fifth of the
        true excess (or is the shunt current of a driver effect)
    branch : that of the same entry, or of the next where that is the current; asked where a sample of one branch has at
        least four times the true excess of the other's
    told : one effect: right name first, or told to be inseparable from another or not excited by the recording
    after_experiment_top1 : one effect told to be inseparable, an excitation proposed: right name first with both recordings
    seconds : median wall time of a diagnosis
    per_effect : id -> top1, top3, count, and by device

    Every rate has `<key>_interval` (Wilson, 95 per cent, over pooled cases) and `<key>_count`. Cases without
    diagnosis are wrong everywhere and listed under `failures`; those below 10 are under `weak`.
    """
    of = {kind: [j for j in judgements if j.kind == kind] for kind in ("none", "one", "two", "outside")}
    one = [j for j in of["one"] if j.counted]
    two = [j for j in of["two"] if j.counted]
    outside = [j for j in of["outside"] if j.counted]
    result: dict[str, Any] = {"cases": len(judgements)}

    def put(key: str, answers: Iterable[bool | None]) -> None:
        result[key], result[f"{key}_interval"], result[f"{key}_count"] = _rate(answers)

    put("false_alarm", (j.alarm for j in of["none"] if not j.failure))
    per_effect = {name: _effect(one, name) for name in sorted({j.truth[0] for j in one})}
    for key in ("top1", "top3"):
        put(key, (getattr(j, key) for j in one))
        result[f"{key}_pooled"] = result[key]
        result[key] = float(np.mean([entry[key] for entry in per_effect.values()])) if per_effect else None
    put("pair_exact", (j.both for j in two))
    put("pair_any", (j.either for j in two))
    put("pair_extra", (j.extra for j in two if not j.failure))
    put("pair_exact_alone", (bool(j.both and not j.extra) for j in two))
    put("outside_unknown", (j.unknown for j in outside))
    result["outside_excess_removed"] = _median(j.removed for j in outside)
    put("outside_half_removed", (j.removed is not None and j.removed >= 0.5 for j in outside))
    result["excess_removed"] = _median(j.removed for j in one)
    _parameters(one, result, put)
    put("channel", (j.channel for j in (*one, *outside)))
    put("branch", (j.branch for j in one))
    put("frequency", (j.frequency for j in one))
    put("signal", (j.signal for j in one))
    seconds = [j.seconds for j in judgements if j.seconds is not None]
    result["seconds"] = _median(seconds)
    result["seconds_max"] = max(seconds, default=None)
    result["limit_stated"] = sum(j.limit for j in one)
    put("excitation_proposed", (j.experiment == "excitation" for j in one))
    put("told", (j.told for j in one))
    put("after_experiment_top1", (j.after_experiment for j in one))
    weak = [j for j in of["one"] if not j.counted]
    result["weak"] = {
        "below_excess": COUNTED_EXCESS,
        "count": len(weak),
        "top1": _rate(j.top1 for j in weak)[0],
        "agrees": _rate(not j.alarm for j in weak)[0],
    }
    result["failures"] = dict(Counter(j.failure for j in judgements if j.failure))
    result["per_effect"] = per_effect
    result["outside"] = {
        name: _group([j for j in outside if j.truth[0] == name], ("unknown",))
        for name in sorted({j.truth[0] for j in outside})
    }
    return result


def _group(judgements: Sequence[Judgement], keys: Sequence[str]) -> dict[str, Any]:
    entry: dict[str, Any] = {key: _rate(getattr(j, key) for j in judgements)[0] for key in keys}
    return entry | {"count": len(judgements)}


def _effect(one: Sequence[Judgement], name: str) -> dict[str, Any]:
    mine = [j for j in one if j.truth[0] == name]
    entry = _group(mine, ("top1", "top3"))
    entry["top1_interval"] = _rate(j.top1 for j in mine)[1]
    entry["device"] = {
        device: _group([j for j in mine if j.device == device], ("top1", "top3"))
        for device in sorted({j.device for j in mine})
    }
    entry["named_instead"] = dict(Counter(j.first for j in mine if not j.top1))
    return entry


def _parameters(one: Sequence[Judgement], result: dict[str, Any], put: Callable) -> None:
    named = [(j.truth[0], j.parameters) for j in one if j.parameters is not None and j.top1]
    errors = [error for _, comparison in named for error in comparison.errors.values()]
    result["parameter_error"] = _median(errors)
    put("coverage90", [held for _, comparison in named for held in comparison.covered.values()])
    by_quantity: dict[str, list[float]] = {}
    for name, comparison in named:
        for quantity, error in comparison.errors.items():
            by_quantity.setdefault(f"{name}.{quantity}", []).append(error)
    result["parameter_error_by_quantity"] = {
        key: _median(found) for key, found in sorted(by_quantity.items())
    }
    result["parameters_compared"] = len(errors)
    result["parameters_unmatched"] = dict(
        Counter(f"{name}.{key}" for name, comparison in named for key in comparison.unmatched)
    )
    result["parameters_missing"] = dict(
        Counter(f"{name}.{key}" for name, comparison in named for key in comparison.missing)
    )
