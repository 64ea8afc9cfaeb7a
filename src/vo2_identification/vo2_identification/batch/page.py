"""One page of many bags: a map of the wafer where the bags say their place, a history of the constants elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_models.page.figures import figure_html, new_figure
from vo2_models.page.page import page, paragraph, section, table

from vo2_identification.batch.table import columns_of

__all__ = ["batch_page"]

Row = Mapping[str, Any]
Floats = NDArray[np.float64]
_ABOUT = (
    "bag",
    "device_id",
    "position_x_m",
    "position_y_m",
    "status",
    "reason",
    "start_s",
    "samples",
    "problems",
)
_MOST_FIGURES = 12
_MOST_DEVICES = 12
_MOST_LINES = 40
_MOST_NAMED = 20
_SEVERAL = 4
"""Bags from which on it is said that most of them differ."""


def batch_page(command: str, rows: Sequence[Row], failed: Mapping[str, str], left: int) -> str:
    """Return the page.

    Parameters
    ----------
    command : fit or diagnose
    rows : of the finished bags
    failed : bag -> what broke down
    left : bags that are not finished
    """
    done = [row for row in rows if row.get("status") == "done"]
    refused = [row for row in rows if row.get("status") != "done"]
    lead = f"{len(done)} bags done, {len(refused)} refused, {len(failed)} broken down, {left} left over."
    parts = []
    if done:
        if "verdict" in done[0]:
            parts += [_verdicts(done), _bags(done)]
        parts.append(_numbers(done))
        parts.append(_figures(done))
    if refused or failed:
        lines = [(row["bag"], row["reason"]) for row in refused] + list(failed.items())
        rest = f" (the first {_MOST_LINES} of {len(lines)})" if len(lines) > _MOST_LINES else ""
        parts.append(section(f"Bags without a result{rest}", table("", ("bag", "why"), lines[:_MOST_LINES])))
    return page(f"{command}: {len(rows) + left + len(failed)} bags", lead, parts)


def _verdicts(done: Sequence[Row]) -> str:
    counts = Counter((row["verdict"], row["effects"] or "none") for row in done)
    lines = [(verdict, effects, number) for (verdict, effects), number in counts.most_common(_MOST_LINES)]
    differ = sum(row["verdict"] == "differs" for row in done)
    said = []
    if len(done) >= _SEVERAL and 2 * differ > len(done):
        said.append(
            paragraph(
                f"{differ} of {len(done)} bags differ. What most of them share the calibration probably lacked: fit it again, "
                "with several recordings or with the effect that is named most, or diagnose with --calibration."
            )
        )
    return section("Verdicts", *said, table("", ("verdict", "effects", "bags"), lines))


def _bags(done: Sequence[Row]) -> str:
    """Which bag got which verdict, those that differ first."""
    order = {"differs": 0, "drifted": 1}
    lines = [
        (row["bag"], row.get("device_id") or "", row["verdict"], row["effects"] or "none")
        for row in sorted(done, key=lambda row: order.get(str(row["verdict"]), 2))
    ]
    rest = f" (the first {_MOST_LINES} of {len(lines)}; all in table.csv)" if len(lines) > _MOST_LINES else ""
    return section(f"Bags{rest}", table("", ("bag", "device", "verdict", "effects"), lines[:_MOST_LINES]))


def _varying(done: Sequence[Row]) -> dict[str, Floats]:
    """Columns of numbers that differ from bag to bag."""
    found = {}
    for name, values in columns_of(done).items():
        if name in _ABOUT or name.endswith(".std"):
            continue
        if any(isinstance(value, str) for value in values):
            continue
        numbers = np.array([np.nan if value is None else value for value in values], float)
        finite = numbers[np.isfinite(numbers)]
        if finite.size and np.ptp(finite) > 1e-9 * np.max(np.abs(finite)):
            found[name] = numbers
    return found


def _numbers(done: Sequence[Row]) -> str:
    lines = []
    for name, values in _varying(done).items():
        finite = values[np.isfinite(values)]
        low, middle, high = np.quantile(finite, (0.05, 0.5, 0.95))
        lines.append((name, finite.size, f"{low:.5g}", f"{middle:.5g}", f"{high:.5g}"))
    return section("Numbers", table("", ("number", "bags", "5 %", "median", "95 %"), lines))


def _figures(done: Sequence[Row]) -> str:
    values = dict(list(_varying(done).items())[:_MOST_FIGURES])
    columns = columns_of(done)
    x, y = (
        np.array([np.nan if value is None else value for value in columns[name]], float)
        for name in ("position_x_m", "position_y_m")
    )
    placed = np.isfinite(x) & np.isfinite(y)
    if np.count_nonzero(placed) >= 3:
        figures = [_map(name, x[placed], y[placed], numbers[placed]) for name, numbers in values.items()]
        unplaced = np.count_nonzero(~placed)
        note = [paragraph(f"{unplaced} bags say no position.")] if unplaced else []
        return section("Map of the wafer", *note, *figures)
    return section("History", *(_history(name, done, numbers) for name, numbers in values.items()))


def _map(name: str, x: Floats, y: Floats, values: Floats) -> str:
    with new_figure(5.0, 4.2) as figure:
        axes = figure.add_subplot()
        known = np.isfinite(values)
        size = float(np.clip(9e4 / x.size, 8.0, 400.0) ** 0.5)
        axes.scatter(1e3 * x[~known], 1e3 * y[~known], marker="x", c="#999999", s=size**2 / 4)
        marks = axes.scatter(1e3 * x[known], 1e3 * y[known], c=values[known], marker="s", s=size**2 / 2)
        figure.colorbar(marks, ax=axes, label=name)
        axes.set(xlabel="x / mm", ylabel="y / mm", aspect="equal")
        axes.margins(0.1)
        return figure_html(figure, f"{name} over the wafer")


def _history(name: str, done: Sequence[Row], values: Floats) -> str:
    start = np.array([row["start_s"] for row in done], float)
    by_time = np.ptp(start) > 0.0
    at = (start - start.min()) / 3600.0 if by_time else np.arange(len(done), dtype=float)
    std = np.array([row.get(f"{name}.std") or np.nan for row in done], float)
    of = np.array([str(row.get("device_id") or "") for row in done])
    devices = list(dict.fromkeys(of))
    with new_figure(7.2, 2.4) as figure:
        axes = figure.add_subplot()
        for number, device in enumerate(devices if len(devices) <= _MOST_DEVICES else [None]):
            mine = np.isfinite(values) & ((of == device) if device is not None else True)
            order = np.flatnonzero(mine)[np.argsort(at[mine], kind="stable")]
            marker = "osD^v<>phX*P"[number % 12]
            line = "-" if device is not None and by_time else ""
            axes.errorbar(
                at[order],
                values[order],
                np.nan_to_num(std[order]),
                marker=marker,
                linestyle=line,
                markersize=3,
                label=device or None,
            )
        axes.set(xlabel="time / h" if by_time else "bag", ylabel=name)
        if not by_time and len(done) <= _MOST_NAMED:
            axes.set_xticks(at, [Path(str(row["bag"])).name[-24:] for row in done], rotation=30, ha="right")
        elif not by_time:
            axes.locator_params(axis="x", integer=True)
        if 1 < len(devices) <= _MOST_DEVICES:
            axes.legend()
        return figure_html(figure, f"{name}, with one standard deviation where it is known")
