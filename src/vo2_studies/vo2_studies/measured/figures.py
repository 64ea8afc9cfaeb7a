"""The figures of the report on measured data."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from numpy.typing import NDArray
from vo2_models.page.figures import COLOURS, figure_html, new_figure
from vo2_models.recording import RESISTANCE

from vo2_studies.measured.cases import Case
from vo2_studies.measured.fitting import CandidateFit
from vo2_studies.measured.laws import LAWS
from vo2_studies.measured.study import SetStudy
from vo2_studies.measured.where import decades, rms_over_time
from vo2_studies.measured.words import scale_of, unit_of

__all__ = ["course_figure", "error_figure", "laws_figure", "piezo_figure"]

Floats = NDArray[np.float64]
_LOOKS = {
    "rate_independent": ("#999999", ":"),
    "one_lag": (COLOURS["reference"], "--"),
    "chosen": (COLOURS["composite"], "-"),
    "best": (COLOURS["polynomial"], "-."),
}


def _models(study: SetStudy) -> list[tuple[str, str, str]]:
    """Candidate ids to draw, with colour and line style."""
    found = [("rate_independent", *_LOOKS["rate_independent"]), ("one_lag", *_LOOKS["one_lag"])]
    found.append((study.chosen.candidate.id, *_LOOKS["chosen"]))
    if study.best.candidate.id not in (name for name, _, _ in found):
        found.append((study.best.candidate.id, *_LOOKS["best"]))
    return found


def _shown(fit: CandidateFit, case: Case) -> Floats:
    """Prediction in log10 R or micrometres."""
    values = fit.predict(case)
    return -values if case.channel == RESISTANCE else 1e6 * values


def course_figure(study: SetStudy) -> str:
    """Held-out recordings over the time since the pulse, measured and predicted."""
    held = [(number, case) for number, fold in enumerate(study.folds) for case in fold.held]
    if study.key == "pulses":
        held = [(2, case) for _, case in held[-1:]] + held[: len(held) - len(study.folds[-1].held)]
    held = held[:6]
    columns = min(len(held), 3)
    rows = -(-len(held) // columns)
    with new_figure(height_in=2.4 * rows + 0.5) as figure:
        axes = np.atleast_1d(figure.subplots(rows, columns, sharey=True)).ravel()
        for axis, (number, case) in zip(axes, held, strict=False):
            values = np.log10(case.recording[case.channel])
            good = np.isfinite(values)
            start = int(np.flatnonzero(good)[0])
            # behind two pulses, what follows the second
            resets = np.flatnonzero(np.diff(case.since_s[start:]) < 0.0)
            if resets.size:
                good[: start + int(resets[-1]) + 2] = False
            since = case.since_s
            axis.semilogx(since[good], values[good], ".", ms=3, color=COLOURS["true"], label="measured")
            for name, colour, style in _models(study):
                judged = study.of(name)
                if number < len(judged.fits):
                    shown = _shown(judged.fits[number], case)
                    axis.semilogx(since[good], shown[good], style, color=colour, label=name)
            late = study.key == "pulses" and number == len(study.folds) - 1
            axis.set_title(f"{case.label}, second pulse" if late else case.label, fontsize=9)
        for axis in axes[len(held) :]:
            axis.set_axis_off()
        for axis in axes[max(len(held) - columns, 0) : len(held)]:
            axis.set_xlabel("time since the pulse [s]")
        for axis in axes[::columns]:
            axis.set_ylabel("log10 (resistance / Ω)")
        handles: dict[str, Artist] = {}
        for axis in axes[: len(held)]:
            for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=5)
        return figure_html(
            figure,
            "Recordings that the fits did not see: resistance after the pulse, measured and predicted from the drive.",
        )


def error_figure(study: SetStudy) -> str:
    """Held-out error over the time since the pulse (piezo: since the start), with the noise."""
    held = [case for fold in study.folds for case in fold.held]
    edges = (
        decades(held)
        if len(study.cases) > 1
        else np.linspace(
            held[0].since_s[np.isfinite(held[0].recording[held[0].channel])][0], held[0].since_s[-1], 17
        )
    )
    middle = np.sqrt(edges[1:] * edges[:-1]) if len(study.cases) > 1 else 0.5 * (edges[1:] + edges[:-1])
    scale = scale_of(study)
    with new_figure(height_in=3.0) as figure:
        axis = figure.subplots()
        for name, colour, style in _models(study):
            judged = study.of(name)
            pairs = [(fit, fold.held) for fit, fold in zip(judged.fits, study.folds, strict=False)]
            error, count = rms_over_time(pairs, edges)
            some = count > 0
            axis.plot(middle[some], scale * error[some], style, marker="o", ms=3, color=colour, label=name)
        axis.axhline(scale * study.noise, color="#000000", lw=0.8, ls=(0, (1, 3)), label="noise")
        axis.set_yscale("log")
        if len(study.cases) > 1:
            axis.set_xscale("log")
        axis.set_xlabel("time since the pulse [s]" if len(study.cases) > 1 else "time [s]")
        axis.set_ylabel(f"held-out error, r.m.s. [{unit_of(study)}]")
        figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=5)
        return figure_html(figure, "Where the error is: root mean square on held-out samples, over time.")


def laws_figure(study: SetStudy) -> str:
    """Errors of the laws of relaxation, recording by recording."""
    with new_figure(height_in=3.0) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        marks = ("s", "o", "^", "v", "D")
        colours = ("#D55E00", "#999999", "#0072B2", "#009E73", "#000000")
        for axis, kind in ((left, "between"), (right, "later")):
            for law, mark, colour in zip(LAWS, marks, colours, strict=True):
                errors = [getattr(result, kind)[law] for result in study.laws]
                axis.plot(range(len(errors)), errors, mark, ls=":", ms=4, color=colour, label=law)
            axis.set_yscale("log")
            axis.set_xticks(range(len(study.laws)), [r.label for r in study.laws], rotation=45, fontsize=7)
        left.set_ylabel("held-out error, r.m.s. [log10 Ω]")
        left.set_title("every other half decade held out", fontsize=9)
        right.set_title("the last 2/3 decade held out", fontsize=9)
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5)
        return figure_html(figure, "Laws fitted to each relaxation alone: errors where they were not fitted.")


def piezo_figure(study: SetStudy) -> str:
    """Start of the recording, and what is left over of each period, by candidate."""
    case = study.cases[0]
    time, deflection = case.since_s, 1e6 * case.recording[case.channel]
    period = round(1.0 / case.recording.sample_period_s)
    with new_figure(height_in=3.2) as figure:
        left, right = figure.subplots(1, 2)
        first = time < 0.5
        left.plot(time[first], deflection[first], ".", ms=3, color=COLOURS["true"], label="measured")
        whole = time.size // period * period
        for name, colour, style in _models(study):
            shown = _shown(study.of(name).fits[0], case)
            left.plot(time[first], shown[first], style, color=colour, label=name)
            gap = (deflection - shown)[:whole].reshape(-1, period)
            right.plot(
                time[:whole:period], gap.mean(axis=1), style, marker=".", ms=3, color=colour, label=name
            )
        right.axvline(
            float(time[np.flatnonzero(np.isfinite(study.folds[0].held[0].recording[case.channel]))[0]]),
            color="#000000",
            lw=0.8,
        )
        right.set_ylim(-0.6, 0.6)
        left.set(xlabel="time [s]", ylabel="deflection [µm]", title="start")
        right.set(xlabel="time [s]", ylabel="mean gap of a period [µm]", title="held out right of the line")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=5)
        return figure_html(
            figure,
            "Piezo: the first half second, and the mean of measured minus model in each period of the sinusoid.",
        )
