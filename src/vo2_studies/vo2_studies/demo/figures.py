"""The figures of the demo's report."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_models.page.figures import COLOURS, figure_html, new_figure
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

from vo2_studies.demo.errors import PhaseData

__all__ = [
    "correction_figure",
    "identification_figure",
    "measured_figure",
    "random_figure",
    "tracking_figure",
]

_UM = 1e6
_POINTS = 2500
_LINES = {"true": "-", "reference": ":", "composite": "-", "polynomial": "--"}
"""A line style each, so that colour never carries a meaning alone."""
_TITLES = {"steps": "Steps", "sine": "Sinusoid", "multisine": "Two frequencies"}


def identification_figure(recording: Recording, model: Recording) -> str:
    """Return resistance and deflection over current: measured and from the fitted model."""
    with new_figure(height_in=3.2) as figure:
        left, right = figure.subplots(1, 2)
        current = recording[HEATER_CURRENT] * 1e3
        for axes, channel, scale in ((left, RESISTANCE, 1e-3), (right, TIP_DEFLECTION, _UM)):
            axes.plot(
                current, recording[channel] * scale, ".", ms=1.5, color=COLOURS["true"], label="measured"
            )
            axes.plot(
                current, model[channel] * scale, "-", lw=0.6, color=COLOURS["fit"], label="fitted model"
            )
            axes.set_xlabel("heater current [mA]")
            axes.legend()
        left.set_yscale("log")
        left.set_ylabel("film resistance [kΩ]")
        right.set_ylabel("tip deflection [µm]")
        return figure_html(
            figure,
            "Damped oscillation of the current: resistance and deflection, measured and from the fitted model.",
        )


def random_figure(data: dict[str, PhaseData]) -> str:
    """Return deflection over time under random levels, and the distribution of the errors."""
    with new_figure(height_in=3.2) as figure:
        left, right = figure.subplots(1, 2, width_ratios=[2, 1])
        shown = slice(0, 800)
        first = next(iter(data.values()))
        left.plot(
            first.time_s[shown], first.true_m[shown] * _UM, "-", color=COLOURS["true"], label="true", lw=1.4
        )
        for scheme, each in data.items():
            style = {"color": COLOURS[scheme], "ls": _LINES[scheme]}
            left.plot(each.time_s[shown], each.estimate_m[shown] * _UM, lw=0.8, label=scheme, **style)
            error = np.sort(np.abs(each.estimate_m - each.true_m)) * _UM
            right.plot(error, np.linspace(0, 100, error.size), label=scheme, **style)
        left.set(xlabel="time [s]", ylabel="tip deflection [µm]")
        right.set(xlabel="|estimate − true| [µm]", ylabel="share of samples below [%]")
        right.set_xscale("log")
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return figure_html(
            figure, "Random current levels, open loop: estimates (first 0.8 s) and how large the errors are."
        )


def tracking_figure(signal: str, data: dict[str, PhaseData]) -> str:
    """Return reference and true deflection over time for both schemes, and the tracking errors."""
    with new_figure(height_in=3.6) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
        for scheme, each in data.items():
            k = _thinned(each.time_s.size)
            style: dict[str, Any] = {
                "color": COLOURS[scheme],
                "ls": _LINES[scheme],
                "lw": 0.8,
                "label": scheme,
            }
            top.plot(each.time_s[k], each.true_m[k] * _UM, **style)
            bottom.plot(each.time_s[k], (each.true_m - each.reference_m)[k] * _UM, **style)
        first = next(iter(data.values()))
        k = _thinned(first.time_s.size)
        top.plot(
            first.time_s[k],
            first.reference_m[k] * _UM,
            color=COLOURS["reference"],
            ls=":",
            lw=1.5,
            label="reference",
        )
        top.set(ylabel="true deflection [µm]", title=_TITLES[signal])
        bottom.set(xlabel="time [s]", ylabel="error [µm]", ylim=(-6, 6))
        figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return figure_html(
            figure,
            f"{_TITLES[signal]}: true deflection under control on the estimate, and its distance from the reference.",
        )


def _thinned(count: int) -> slice:
    return slice(0, count, max(1, count // _POINTS))


def measured_figure(
    title: str,
    output: str,
    drive: NDArray[np.float64],
    measured: NDArray[np.float64],
    predicted: NDArray[np.float64],
    unseen: NDArray[np.bool_],
) -> str:
    """Return measured and predicted output over the drive, and over the sample number."""
    with new_figure(height_in=3.0) as figure:
        left, right = figure.subplots(1, 2)
        scale, label = (1e-3, "resistance [kΩ]") if output == RESISTANCE else (_UM, "displacement [µm]")
        index = np.arange(drive.size)
        for axes, x in ((left, drive), (right, index)):
            axes.plot(x, measured * scale, "-", color=COLOURS["true"], lw=1.2, label="measured")
            for part, key, name in (
                (~unseen, "fit", "predicted, seen"),
                (unseen, "held_out", "predicted, held out"),
            ):
                axes.plot(x[part], predicted[part] * scale, ".", ms=1.5, color=COLOURS[key], label=name)
            if output == RESISTANCE:
                axes.set_yscale("log")
            axes.set_ylabel(label)
        left.set_xlabel("voltage [V]")
        right.set_xlabel("sample")
        left.legend(markerscale=4)
        return figure_html(
            figure, f"{title}: measured and predicted from the voltage by the estimator, on the replayed bag."
        )


def correction_figure(recording: Recording, before: Recording, after: Recording) -> str:
    """Return what the identified and the corrected model leave over, over time."""
    with new_figure(height_in=3.2) as figure:
        top, bottom = figure.subplots(2, 1, sharex=True)
        time = recording.time_s - recording.time_s[0]
        for label, model, key, style in (
            ("identified model", before, "held_out", "-"),
            ("corrected model", after, "fit", "--"),
        ):
            look: dict[str, Any] = {"color": COLOURS[key], "ls": style, "lw": 0.6, "label": label}
            gap = np.log10(recording[RESISTANCE] / model[RESISTANCE])
            top.plot(time, gap, **look)
            bottom.plot(time, (recording[TIP_DEFLECTION] - model[TIP_DEFLECTION]) * _UM, **look)
        top.set(ylabel="residual of\nlog10(R / Ω)")
        bottom.set(xlabel="time [s]", ylabel="residual of\ndeflection [µm]")
        figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        return figure_html(
            figure, "Recording minus simulation, with the identified and with the corrected model."
        )
