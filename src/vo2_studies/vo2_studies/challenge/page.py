"""The page of a proof: what is hardest first, then every line, the reliability of probabilities, and all that missed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from vo2_models.page.figures import COLOURS, figure_html, new_figure
from vo2_models.page.page import page, paragraph, section, table

from vo2_studies.challenge.confusion import confusion_figure
from vo2_studies.challenge.judging import COUNTED_EXCESS, Judgement

__all__ = ["challenge_page", "score_lines"]

MEASURES = (
    ("top1", "right name first (mean over effects)"),
    ("top3", "right name among first three"),
    ("told", "named, or told inseparable, not excited"),
    ("after_experiment_top1", "right after proposed experiment"),
    ("excess_removed", "one effect: excess removed, median"),
    ("outside_excess_removed", "outside: excess removed, median"),
    ("parameter_error", "parameter error, median"),
    ("coverage90", "90 % intervals hold the truth"),
    ("moved_coverage90", "the same of moved gains, lags, rooms"),
    ("channel", "right channel"),
    ("branch", "right branch"),
    ("frequency", "resonance within 5 %"),
    ("signal", "right sensor named"),
)
"""Key of challenge.json, words; shown below the lines."""
HEAD = ("line", "under", "rate", "95 % interval", "cases", "wanted", "")


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f} %"


def _spread(bounds: Sequence[float] | None) -> str:
    return f"{100 * bounds[0]:.0f} to {100 * bounds[1]:.0f} %" if bounds else ""


def _row(figure: Mapping[str, Any]) -> list[str]:
    where = "all" if figure["heading"] == "all" else f"{figure['heading']}: {figure['value_of']}"
    low, high = figure["interval"]
    verdict = "met" if figure["met"] else "missed"
    if low < figure["wanted"] < high:
        verdict += ", the interval holds both"
    wanted = f"at {figure['side']} {100 * figure['wanted']:.0f} %"
    return [
        figure["words"],
        where,
        _percent(figure["rate"]),
        _spread((low, high)),
        str(figure["count"]),
        wanted,
        verdict,
    ]


def score_lines(scores: Mapping[str, Any]) -> list[list[str]]:
    """Return the lines over all cases, then the other measures: words, under, rate, interval, cases, wanted, verdict."""
    lines = [_row(figure) for figure in scores["figures"]]
    for key, words in MEASURES:
        count = scores.get(f"{key}_count")
        if scores.get(key) is not None:
            spread = _spread(scores.get(f"{key}_interval"))
            lines.append(
                [words, "all", _percent(scores[key]), spread, "" if count is None else str(count), "", ""]
            )
    if scores["seconds"] is not None:
        lines.append(["seconds a diagnosis, median", "all", f"{scores['seconds']:.1f}", "", "", "", ""])
    return lines


def _reliability_figure(bins: Iterable[Mapping[str, Any]]) -> str:
    with new_figure(4.2, 3.8) as figure:
        axes = figure.add_subplot()
        axes.plot([0, 1], [0, 1], color=COLOURS["reference"], linestyle=":", label="stated = observed")
        for k, one in enumerate(bins):
            below, above = (abs(one["observed"] - bound) for bound in one["interval"])
            axes.errorbar(
                one["stated"],
                one["observed"],
                yerr=[[below], [above]],
                fmt="o",
                color=COLOURS["fit"],
                label="observed, 95 % interval" if k == 0 else None,
            )
            axes.annotate(
                str(one["count"]), (one["stated"], one["observed"]), (5, -9), textcoords="offset points"
            )
        axes.set(
            xlabel="stated probability", ylabel="share that is true", xlim=(-0.03, 1.03), ylim=(-0.03, 1.03)
        )
        axes.legend(loc="upper left")
        return figure_html(
            figure, "Stated probability of every effect against the share that is true; numbers: entries."
        )


def _rates_figure(figures: Sequence[Mapping[str, Any]]) -> str:
    with new_figure(7.2, 0.6 + 0.3 * len(figures)) as figure:
        axes = figure.add_subplot()
        for k, one in enumerate(figures):
            axes.plot(one["interval"], [k, k], color=COLOURS["fit"])
            axes.plot(one["rate"], k, "o", color=COLOURS["fit"])
            axes.plot(one["wanted"], k, "|", color=COLOURS["held_out"], markersize=12)
        axes.set_yticks(range(len(figures)), [one["words"] for one in figures], fontsize=8)
        axes.invert_yaxis()
        axes.set(xlim=(-0.02, 1.02), xlabel="share of the cases; bar: what is wanted")
        return figure_html(figure, "Every line over all cases with its 95 % interval.")


def challenge_page(scores: Mapping[str, Any], judgements: Sequence[Judgement], command: str) -> str:
    """Return the self-contained HTML page of a proof."""
    worst = scores["hardest"]
    lead = f"{scores['cases']} concealed cases, drawn and scored by: {command}."
    if worst:
        lead = f"Hardest: {' '.join(_row(worst[0])[:3])} of {worst[0]['count']} cases. " + lead
    under = "; ".join(
        f"{heading}: " + ", ".join(f"{value} {n}" for value, n in counts.items())
        for heading, counts in scores["settings"].items()
    )
    effects = [
        [
            name,
            str(entry["count"]),
            _percent(entry["top1"]),
            _percent(entry["top3"]),
            ", ".join(f"{other} {n}" for other, n in entry["named_instead"].items()),
        ]
        for name, entry in scores["per_effect"].items()
    ]
    bins = [
        [
            f"{b['from']:g} to {b['to']:g}",
            str(b["count"]),
            _percent(b["stated"]),
            _percent(b["observed"]),
            _spread(b["interval"]),
            "met" if b["met"] else "missed",
        ]
        for b in scores["reliability"]
    ]
    missed = [
        [str(m["index"]), m["kind"], " + ".join(m["truth"]) or "-", m["said"]]
        + [str(m.get(key, "")) for key in ("hysteresis", "condition", "excitation", "device")]
        for m in scores["missed"]
    ]
    split = [_row(figure) for figures in scores["by_heading"].values() for figure in figures]
    return page(
        "Diagnosis on concealed data",
        lead,
        [
            section(
                "Hardest conditions first", table("Lines that fall shortest", HEAD, [_row(f) for f in worst])
            ),
            section(
                "All cases",
                _rates_figure(scores["figures"]),
                table("Lines, then other measures", HEAD, score_lines(scores)),
                paragraph(
                    f"Cases by {under}. Intervals are Wilson's over pooled cases. An effect counts from an excess residual "
                    f"of {COUNTED_EXCESS:g} times the noise power; {scores['weak']['count']} weaker ones are left out."
                ),
            ),
            section(
                "Probabilities",
                _reliability_figure(scores["reliability"]),
                table(
                    "Reliability",
                    ("stated", "entries", "mean stated", "true", "95 % interval", "within 5 points"),
                    bins,
                ),
            ),
            section("Under each condition", table("Lines by condition", HEAD, split)),
            section("Confusion", confusion_figure(judgements)),
            section(
                "Effects",
                table(
                    "Change since calibration",
                    ("effect", "cases", "first", "first three", "named instead"),
                    effects,
                ),
            ),
            section(
                "Everything that missed",
                table(
                    "Cases",
                    ("case", "kind", "truth", "said", "hysteresis", "condition", "excitation", "device"),
                    missed,
                ),
                paragraph(f"Without diagnosis: {scores['failures'] or 'none'}."),
            ),
        ],
    )
