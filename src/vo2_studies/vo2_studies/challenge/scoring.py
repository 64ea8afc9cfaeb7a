"""From judged cases to `challenge.json`: the contract's keys, Wilson intervals, and what stands behind them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from vo2_studies.challenge.figures import figures, hardest, rate
from vo2_studies.challenge.judging import COUNTED_EXCESS, SETTINGS, Judgement
from vo2_studies.challenge.plan import KINDS
from vo2_studies.challenge.reliability import reliability

__all__ = ["score"]


def _median(values: Iterable[float | None]) -> float | None:
    known = [float(value) for value in values if value is not None]
    return float(np.median(known)) if known else None


def score(judgements: Sequence[Judgement]) -> dict[str, Any]:
    """Return the content of `challenge.json`.

    Keys of the contract
    --------------------
    cases : judged cases
    false_alarm : of the unchanged devices, same day and others, those with verdict "differs" or any effect named
    top1, top3 : one effect, excess over 10 noise powers: right name first / among the first three of the ranking,
        a rightly stated limit included; the mean over effects of each effect's rate (`*_pooled` over cases)
    pair_exact : two effects, both over 10: both named; `pair_any` at least one; `pair_extra` a wrong name besides
        (`pair_exact_alone`: both and nothing else)
    outside_unknown : outside the catalogue, over 10: "unknown" first and no catalogue name
    outside_excess_removed, excess_removed : median share of the excess residual removed on held-out data, of the
        cases outside the catalogue and of those with one effect
    parameter_error : median relative error of the matched parameters of rightly named effects
    coverage90 : share of these whose interval value +- 1.645 std holds the truth
    moved_coverage90 : the same of the told move of a constant that was moved, of gains, time constants and the room
    channel : one effect or outside: the channel of the largest share of excess carries at least a fifth of the
        true excess (or is the shunt current of a driver effect)
    branch : that of the same entry, or of the next where that is the current; asked where a sample of one branch has at
        least four times the true excess of the other's
    told : one effect: right name first, or told to be inseparable from another or not excited by the recording
    after_experiment_top1 : one effect told to be inseparable, an excitation proposed: right name first with both recordings
    seconds : median wall time of a diagnosis
    per_effect : id -> top1, top3, count, and by device

    figures : the lines of `figures.LINES`, each with rate, interval, count and what is wanted; `by_heading` the same under
        each condition, `hardest` the ten of these that fall shortest
    reliability : bins of stated probability against the share that is true
    missed : every case that a line counts as wrong, with what was said
    settings : families of hysteresis, conditions, excitations and devices, with their counts

    Every rate has `<key>_interval` (Wilson, 95 per cent, over pooled cases) and `<key>_count`. Cases without
    diagnosis are wrong everywhere and listed under `failures`; those below 10 are under `weak`.
    """
    of = {kind: [j for j in judgements if j.kind == kind] for kind in KINDS}
    one = [j for j in of["one"] if j.counted]
    two = [j for j in of["two"] if j.counted]
    outside = [j for j in of["outside"] if j.counted]
    result: dict[str, Any] = {"cases": len(judgements)}

    def put(key: str, answers: Iterable[bool | None]) -> None:
        result[key], result[f"{key}_interval"], result[f"{key}_count"] = rate(answers)

    put("false_alarm", (j.alarm for j in (*of["none"], *of["day"]) if not j.failure))
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
    put("moved_coverage90", (j.constant_held for j in judgements))
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
        "top1": rate(j.top1 for j in weak)[0],
        "agrees": rate(not j.alarm for j in weak)[0],
    }
    result["failures"] = dict(Counter(j.failure for j in judgements if j.failure))
    result["per_effect"] = per_effect
    result["figures"] = [figure.plain() for figure in figures(judgements)]
    result["by_heading"] = {
        heading: [figure.plain() for figure in figures(judgements, heading)] for heading in SETTINGS
    }
    result["hardest"] = [figure.plain() for figure in hardest(judgements)[:10]]
    result["reliability"] = reliability(judgements)
    result["missed"] = [_missed(j) for j in judgements if j.counted and not _right(j)]
    result["settings"] = {
        heading: dict(Counter(str(j.settings.get(heading, "")) for j in judgements)) for heading in SETTINGS
    }
    return result


def _right(j: Judgement) -> bool:
    """Whether nothing that is asked of the case is wrong."""
    asked = {
        "none": not j.alarm,
        "day": not j.alarm,
        "moved": j.constant,
        "two": j.both,
        "outside": j.unknown and j.family,
    }.get(j.kind, j.top1)
    return bool(asked) and j.verdict and not j.wrong


def _missed(j: Judgement) -> dict[str, Any]:
    return {
        "index": j.index,
        "kind": j.kind,
        "truth": list(j.truth),
        "said": j.failure or j.first,
        "verdict_right": j.verdict,
        "wrong_name": j.wrong,
        "family_right": j.family,
        **j.settings,
    }


def _group(judgements: Sequence[Judgement], keys: Sequence[str]) -> dict[str, Any]:
    entry: dict[str, Any] = {key: rate(getattr(j, key) for j in judgements)[0] for key in keys}
    return entry | {"count": len(judgements)}


def _effect(one: Sequence[Judgement], name: str) -> dict[str, Any]:
    mine = [j for j in one if j.truth[0] == name]
    entry = _group(mine, ("top1", "top3"))
    entry["top1_interval"] = rate(j.top1 for j in mine)[1]
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
