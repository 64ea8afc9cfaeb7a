"""The page that a lab colleague reads: verdict, where, what, gain, what next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from vo2_models.diagnosis.breakdown import Breakdown, branch_words
from vo2_models.diagnosis.explain import Explanation
from vo2_models.diagnosis.nominal import JUDGED_UNIT
from vo2_models.diagnosis.report import course_of, excess_by_channel, left_by_the_answer, moved_in_place
from vo2_models.diagnosis.result import Diagnosis, NamedEffect
from vo2_models.diagnosis.stages import Study
from vo2_models.page.figures import figure_html, new_figure
from vo2_models.page.page import page, paragraph, section, subsection, table
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION
from vo2_models.units import shown_unit

__all__ = ["report_page"]

Floats = NDArray[np.float64]
SHOWN = {
    RESISTANCE: ("resistance", "residual of\n1000 log10(R/ohm)", 1e3),
    TIP_DEFLECTION: ("deflection", "residual of\ndeflection / um", 1e6),
    STAGE_TEMPERATURE: ("stage temperature", "residual of\ntemperature / K", 1.0),
    HEATER_CURRENT: ("heater current", "residual of\ncurrent / mA", 1e3),
}
SPANS = 4
"""Stretches of time that are written out."""
UNITS = {RESISTANCE: "ohm", TIP_DEFLECTION: "m", STAGE_TEMPERATURE: "degC", HEATER_CURRENT: "A"}
"""Those for which the labels above are written."""
BEFORE, AFTER, NOISE = "#D55E00", "#0072B2", "#999999"
"""From the palette of Okabe and Ito; line style and label carry the meaning too."""
COURSES = (("#0072B2", "-"), ("#D55E00", "--"), ("#009E73", ":"), ("#CC79A7", "-."))
"""Colour and line style of each recording in turn."""


LINEAR, WIDE = 4.0, 5.0
"""Standard deviations of the noise, up to the next decade, beyond which a residual's axis is logarithmic if it goes so many
times further."""


def report_page(study: Study, diagnosis: Diagnosis) -> str:
    """Return the self-contained HTML page.

    Parameters
    ----------
    study : of the recordings
    diagnosis : what `assemble_diagnosis` made of it
    """
    parts = [_by_recording(diagnosis)] if diagnosis.recordings else []
    parts.append(_agreement(study) if diagnosis.verdict == "agrees" else _where(study, diagnosis))
    if diagnosis.moved:
        parts.append(_moved(study, diagnosis))
    if diagnosis.effects:
        parts.append(_what(study, diagnosis))
    if diagnosis.not_excited:
        parts.append(_not_excited(diagnosis))
    parts += [_gain(study, diagnosis), _next(diagnosis), _data(study, diagnosis)]
    return page("Diagnosis: simulation against recording", diagnosis.summary, parts)


def _by_recording(diagnosis: Diagnosis) -> str:
    """The answer of each recording: all else on the page is of one of them."""
    rows = []
    for day in diagnosis.recordings:
        others = [name for name in day.judged_with if name != day.recording]
        names = [
            ", ".join(e.siblings or [e.id])
            + (f" on {e.signal}" if e.signal and not e.siblings else "")
            + f" ({e.probability:.2f})"
            for e in day.effects
        ]
        figures = [
            f"{name} {e.value:.4g} ± {e.std:.2g} {'' if e.unit == '1' else e.unit}"
            for effect in day.effects
            for name, e in effect.parameters.items()
            if e.std
        ] + [
            f"{m} {m.was:.5g} → {m.now:.5g} ± {m.std:.2g} {'' if m.unit == '1' else m.unit}"
            for m in day.moved
        ]
        rows.append(
            (day.recording, day.verdict, "; ".join(names), "; ".join(figures), ", ".join(others) or "itself")
        )
    return section(
        "By recording",
        paragraph(
            "Not all recordings have the same answer. What follows below is of those that the summary names last."
        ),
        table(
            "Answers",
            ("recording", "verdict", "left out (probability)", "figures, standard deviation", "judged with"),
            rows,
        ),
    )


def _labels(study: Study) -> dict[str, tuple[str, str, float]]:
    """Channel -> its name, the label of its residual, and the factor to that label's unit: of a rig, by its own file."""
    device = study.located.problem.nominal.model.description
    found = dict(SHOWN)
    for channel, own in device.names.items():
        unit = device.units[channel]
        if own == channel and unit == UNITS[channel]:
            continue
        unit, factor = shown_unit(unit)
        found[channel] = (own, f"residual of\n{own} / {unit}", factor)
        if channel == RESISTANCE:
            found[channel] = (own, f"residual of\n1000 log10({own}/{unit})", 1e3)
    return found


def _own_labels(study: Study) -> dict[str, tuple[str, str, float]]:
    """The same by the names of the device's own file, as a diagnosis has them."""
    names = study.located.problem.nominal.model.description.names
    return {names.get(role, role): label for role, label in _labels(study).items()}


def _agreement(study: Study) -> str:
    return section(
        "How they agree",
        paragraph(
            "Before: the fitted simulation as it is. After: with what a refit of loop shape and heat, within the "
            "uncertainty of the calibration, makes of it."
        ),
        _residual_figure(study),
    )


def _where(study: Study, diagnosis: Diagnosis) -> str:
    labels, device = _labels(study), study.located.problem.nominal.model.description
    own, branches = _own_labels(study), branch_words(device)
    rows = [
        (
            own[p.signal][0],
            f"{100 * p.share:.0f}\u00a0%",
            branches.get(p.branch, p.branch),
            "-"
            if p.temperature_degC is None
            else f"{p.temperature_degC[0]:.1f} to {p.temperature_degC[1]:.1f}",
            f"{p.frequency_hz[0]:.3g} to {p.frequency_hz[1]:.3g}",
            ", ".join(f"{a:.4g}-{b:.4g}" for a, b in p.time_s[:SPANS])
            + (" ..." if len(p.time_s) > SPANS else ""),
        )
        for p in diagnosis.location
    ]
    return section(
        "Where it differs",
        paragraph(
            "Excess is residual energy beyond the noise, in units of the noise's own; what a refit of loop "
            "shape and heat can absorb is taken off first. Shares of the channels add up to one."
        ),
        table(
            "Location of the excess",
            ("channel", "share", "branch", _loop_axis(device.has_body), "frequency / Hz", "mostly at / s"),
            rows,
        ),
        _residual_figure(study),
        _map_figure(excess_by_channel(study), labels, _loop_axis(device.has_body)),
    )


def _loop_axis(has_body: bool) -> str:
    return "film temperature / degC" if has_body else "loop coordinate (30 to 90: the drive's range)"


def _residual_figure(study: Study) -> str:
    """Residual over time, before and after, per channel of the first recording."""
    labels = _labels(study)
    problem = study.located.problem
    rows = [(row, part) for row, part, _ in problem.iterate() if row.part == 0]
    after = left_by_the_answer(study)
    wide = ""
    stepped = {one.signal for one in study.reading.evident if "step" in one.values}
    of_first = f"of the first recording, {problem.parts[0].name}, " if len(problem.parts) > 1 else ""
    with new_figure(7.2, 1.9 * len(rows) + 0.4) as figure:
        axes = np.atleast_1d(figure.subplots(len(rows), 1, sharex=True))
        for axis, (row, part) in zip(axes, rows, strict=True):
            noise = problem.nominal.noise[row.channel]
            _, label, scale = labels[row.channel]
            time = part.time_s - part.time_s[0]
            before = problem.residual_as_fitted(row)
            explained = problem.in_its_unit(row, after)
            # light and dark, so that grey print tells them apart too
            bands = (before, BEFORE, 0.45, "before"), (explained, AFTER, 0.9, "after")
            for plain, colour, alpha, name in bands:
                low, high, middle = _envelope(time, plain * scale)
                axis.fill_between(middle, low, high, color=colour, alpha=alpha, linewidth=0, label=name)
            size = part.uneven.get(row.channel, np.ones(part.size))
            rounding = part.comb_level(row.channel) if row.channel in stepped else 0.0
            level, _, middle = _envelope(time, 2.0 * np.hypot(noise.level * size, rounding) * scale)
            for sign, name in ((-1, "two standard deviations of the noise"), (1, "_")):
                axis.plot(middle, sign * level, color=NOISE, linestyle="--", linewidth=0.8, label=name)
            axis.set_ylabel(label)
            linear = 10.0 ** np.ceil(np.log10(LINEAR * noise.level * scale))  # a decade has a tick
            if np.max(np.abs(before * scale)) > WIDE * linear:
                axis.set_yscale("symlog", linthresh=linear)
                wide = " Where it goes far beyond the noise an axis is logarithmic there."
        axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
        axes[-1].set_xlabel("time / s")
        return figure_html(
            figure,
            f"Residual (measured minus simulated) {of_first}over time; each band spans the smallest and largest value of an "
            "interval. Before: by the model file as it is. After: with the correction, and the loop shape refitted within the "
            f"uncertainty of the calibration.{' The noise of a channel of steps holds their rounding.' if stepped else ''}{wide}",
        )


def _where_flat(study: Study, channel: str, level: float) -> str:
    """What a level is where the response is flat, if the law misses steep places by more."""
    sizes = [
        float(part.uneven[channel].min()) for part in study.located.problem.parts if channel in part.uneven
    ]
    return f", {level * min(sizes):.3g} where it is flat" if sizes else ""


def _envelope(time: Floats, values: Floats, pieces: int = 500) -> tuple[Floats, Floats, Floats]:
    edges = np.unique(np.linspace(0, time.size, min(pieces, time.size) + 1).astype(int))[:-1]
    return (
        np.minimum.reduceat(values, edges),
        np.maximum.reduceat(values, edges),
        time[edges],
    )


def _map_figure(
    shown: Sequence[Breakdown], labels: Mapping[str, tuple[str, str, float]], loop_axis: str
) -> str:
    """Excess energy per channel over temperature, frequency, branch and memory."""
    if not shown:
        return ""
    colours = dict(zip(SHOWN, ("#0072B2", "#D55E00", "#009E73", "#CC79A7"), strict=True))
    marks = dict(zip(SHOWN, ("-", "--", ":", "-."), strict=True))
    with new_figure(7.2, 4.4) as figure:
        grid = figure.subplots(2, 2)
        for b in shown:
            name, style = labels[b.channel][0], {"color": colours[b.channel], "linestyle": marks[b.channel]}
            edges, energy = b.axes["temperature"]
            grid[0, 0].stairs(energy / max(b.excess, 1e-9), edges, label=name, **style)
            frequency, power = b.axes["frequency"]
            grid[0, 1].semilogx(
                frequency[1:], np.cumsum(power)[1:] / max(float(np.sum(power)), 1e-9), **style
            )
        width = 0.8 / len(shown)
        for place, (axis, key, title) in enumerate(
            ((grid[1, 0], "branch", "branch"), (grid[1, 1], "reversals", "open reversals (minor-loop depth)"))
        ):
            for k, b in enumerate(shown):
                names, energy = b.axes[key]
                x = np.arange(len(names)) + (k - 0.5 * (len(shown) - 1)) * width
                axis.bar(
                    x,
                    energy / max(b.excess, 1e-9),
                    width,
                    color=colours[b.channel],
                    hatch=("", "//", "..", "xx")[k],
                )
                axis.set_xticks(np.arange(len(names)), names)
            axis.set_xlabel(title)
            axis.set_ylabel("share of the excess")
            del place
        grid[0, 0].set_xlabel(loop_axis)
        grid[0, 0].set_ylabel("share of the excess")
        grid[0, 0].legend()
        grid[0, 1].set_xlabel("frequency / Hz")
        grid[0, 1].set_ylabel("share below")
        grid[0, 1].set_ylim(0.0, 1.05)
        return figure_html(
            figure,
            f"Where each channel's excess sits: over {loop_axis.partition(' / ')[0]}, over frequency (cumulative), on which "
            "branch, and how deep in minor loops.",
        )


def _course_figures(study: Study) -> list[str]:
    """The course in time of each effect of the answer that has one."""
    chosen = study.decision.chosen
    return [
        _course_figure(study, chosen, index)
        for index, hypothesis in enumerate(chosen.hypotheses if chosen else ())
        if chosen and hypothesis.key in chosen.courses
    ]


def _course_figure(study: Study, chosen: Explanation, index: int) -> str:
    values, unit = course_of(study, chosen, index)
    name = chosen.hypotheses[index].record.id
    with new_figure(7.2, 2.4) as figure:
        axis = figure.subplots()
        for k, (part, course) in enumerate(zip(study.located.problem.parts, values, strict=True)):
            colour, style = COURSES[k % len(COURSES)]
            axis.plot(part.time_s - part.time_s[0], course, color=colour, linestyle=style, label=part.name)
        axis.set_xlabel("time / s")
        axis.set_ylabel(f"{name} / {unit}")
        if len(values) > 1:
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)
        return figure_html(
            figure,
            f"Course of {name} over the time of each recording, as it was fitted: slow splines, of which an even part may be "
            "what constants have moved by.",
        )


def _what(study: Study, diagnosis: Diagnosis) -> str:
    labels = _own_labels(study)
    parts = [_effect(effect, labels) for effect in diagnosis.effects]
    parts += _course_figures(study)
    if diagnosis.candidates:
        rows = [
            (
                ("something else (unknown)" if c.id == "unknown" else c.id)
                + (f" ({labels[c.signal][0]})" if c.signal else ""),
                f"{c.probability:.3f}",
                f"{100 * c.explained_share:.0f} %",
                c.why_not or ("something that is in no catalogue" if c.id == "unknown" else "the answer"),
            )
            for c in diagnosis.candidates
        ]
        parts.append(table("Candidates", ("effect", "probability", "of the excess", "why, or why not"), rows))
    if not study.decision.equivalent:  # of a set all are told together, above
        parts += [
            paragraph(f"These recordings do not tell {first} from {second}.")
            for first, second in diagnosis.indistinguishable
        ]
    return section("What was left out", *parts)


def _not_excited(diagnosis: Diagnosis) -> str:
    names = ", ".join(diagnosis.not_excited)
    return section(
        "What these recordings do not show",
        paragraph(f"Not excited by these recordings, so neither present nor absent: {names}."),
    )


def _moved(study: Study, diagnosis: Diagnosis) -> str:
    """Constants that have moved since the calibration."""
    rows = [
        (str(m), f"{m.was:.6g}", f"{m.now:.6g}", f"{m.std:.2g}", "" if m.unit == "1" else m.unit)
        for m in diagnosis.moved
    ]
    return section(
        "Constants that have moved",
        paragraph("Another day is not new physics: the same equations with other constants."),
        table("Constants", ("constant", "was", "is", "standard deviation", "unit"), rows),
        *(paragraph(f"By these recordings {others}.") for others in moved_in_place(study)),
    )


def _effect(effect: NamedEffect, labels: Mapping[str, tuple[str, str, float]]) -> str:
    name = effect.id.replace("_", " ") + (f" on {labels[effect.signal][0]}" if effect.signal else "")
    if effect.id == "unknown":
        name = f"One of {', '.join(effect.siblings)}" if effect.siblings else "Something without a name"
    first = effect.form.partition("; ")[0] + ". "
    parts = [
        paragraph(f"Family: {effect.family}. Form: {effect.form}."),
        *(
            [paragraph(f"Not told from {', '.join(effect.siblings)} by these recordings.")]
            if effect.siblings and effect.id != "unknown"
            else []
        ),
        paragraph(effect.statement.removeprefix(first)),
        paragraph(f"Added term: {effect.equation}"),
    ]
    if effect.parameters:
        rows = [
            (key, f"{e.value:.4g}", f"{e.std:.2g}" if e.std else "not fitted", e.unit)
            for key, e in effect.parameters.items()
        ]
        parts.append(table("Parameters", ("parameter", "value", "standard deviation", "unit"), rows))
    return subsection(f"{name} (probability {effect.probability:.2f})", *parts)


def _gain(study: Study, diagnosis: Diagnosis) -> str:
    labels = _own_labels(study)
    rows = [
        (
            labels[c][0],
            f"{100 * f.nrmse_before:.3f} %",
            f"{100 * f.nrmse_after:.3f} %",
            f"{100 * f.noise_floor:.3f} %",
        )
        for c, f in diagnosis.fit.items()
    ]
    return section(
        "What it gains",
        paragraph(
            "Root mean square error over the channel's range, on long blocks that were left out of the fit "
            "(two folds of alternating blocks). What the calibration leaves open in the shape of the loops is refitted "
            "on the other blocks, which helps only where they went through the same loops: an unchanged device too may lie well "
            "above its noise here. The verdict counts that as uncertainty of the calibration, the table as an error."
        ),
        table("Held-out error", ("channel", "before", "after", "noise floor"), rows),
    )


def _next(diagnosis: Diagnosis) -> str:
    proposal = diagnosis.next_experiment
    if proposal is None:
        return section(
            "What to record next", paragraph("Nothing: no two explanations are left to tell apart.")
        )
    return section("What to record next", paragraph(proposal.why), paragraph(proposal.instruction))


def _data(study: Study, diagnosis: Diagnosis) -> str:
    labels, device = _labels(study), study.located.problem.nominal.model.description
    rows = [
        (
            part.name,
            f"{part.size}",
            f"{part.dt:.4g}",
            ", ".join(labels[c][0] for c in part.channels),
            "at its first current" if part.settled else "at rest, cold",
        )
        for part in study.located.problem.parts
    ]
    limits = [paragraph(text) for text in diagnosis.limits] or [paragraph("Nothing limits the answer.")]
    noise = [
        (
            labels[c][0],
            f"{n.level:.3g}" + _where_flat(study, c, n.level),
            JUDGED_UNIT[c] if c == RESISTANCE else device.units[c],
            ", ".join(f"{a:.2f}" for a in n.ar) or "none: white",
        )
        for c, n in study.located.problem.nominal.noise.items()
    ]
    return section(
        "The data",
        table("Recordings", ("recording", "samples", "period / s", "channels", "began"), rows),
        table("Noise", ("channel", "level", "unit", "correlation with the samples before (AR)"), noise),
        *limits,
    )
