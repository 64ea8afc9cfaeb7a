"""Deflection set-points as functions of time: steps, sums of sinusoids, tables.

>>> round(reference_signal("integrated", "sine").at(2.5) * 1e6, 6)
45.0
"""

from __future__ import annotations

import csv
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from vo2_models.device.description import preset
from vo2_models.validation import finite_array, increasing, positive_number

__all__ = ["REFERENCES", "Multisine", "ReferenceSignal", "Steps", "Table", "read_table", "reference_signal"]


class ReferenceSignal(Protocol):
    """A set-point over time; after its duration it stays where it ended."""

    @property
    def duration_s(self) -> float:
        """How long the signal lasts [s]."""
        ...

    def at(self, time_s: float) -> float:
        """Return the set-point [m] at `time_s` [s] since its start."""
        ...


@dataclass(frozen=True)
class Steps:
    """Constant levels [m], each held for `hold_s` [s]."""

    levels_m: tuple[float, ...]
    hold_s: float

    def __post_init__(self) -> None:
        finite_array(self.levels_m, "steps.levels_m")
        if not self.levels_m:
            raise ValueError("steps.levels_m: found no level, need at least one")
        positive_number(self.hold_s, "steps.hold_s")

    @property
    def duration_s(self) -> float:
        return self.hold_s * len(self.levels_m)

    def at(self, time_s: float) -> float:
        # a stamp is whole nanoseconds: half of one keeps a level from starting a sample late
        index = int(max(time_s + 0.5e-9, 0.0) / self.hold_s)
        return self.levels_m[min(index, len(self.levels_m) - 1)]


@dataclass(frozen=True)
class Multisine:
    """offset + sum of amplitude * sin(2 pi frequency t) [m], with t in s."""

    offset_m: float
    amplitudes_m: tuple[float, ...]
    frequencies_hz: tuple[float, ...]
    duration_s: float

    def __post_init__(self) -> None:
        finite_array([self.offset_m, *self.amplitudes_m, *self.frequencies_hz], "multisine")
        if len(self.amplitudes_m) != len(self.frequencies_hz) or not self.amplitudes_m:
            raise ValueError(
                f"multisine.frequencies_hz: found {len(self.frequencies_hz)}, "
                f"need as many as amplitudes ({len(self.amplitudes_m)}), at least one"
            )
        positive_number(self.duration_s, "duration_s")

    def at(self, time_s: float) -> float:
        waves = zip(self.amplitudes_m, self.frequencies_hz, strict=True)
        return self.offset_m + sum(a * math.sin(2.0 * math.pi * f * time_s) for a, f in waves)


@dataclass(frozen=True)
class Table:
    """Linear interpolation between (time [s], deflection [m]) pairs."""

    time_s: tuple[float, ...]
    values_m: tuple[float, ...]

    def __post_init__(self) -> None:
        time = increasing(finite_array(self.time_s, "time_s"), "time_s")
        finite_array(self.values_m, "tip_deflection", size=time.size)
        if time.size == 0:
            raise ValueError("time_s: found no row, need at least one")

    @property
    def duration_s(self) -> float:
        return self.time_s[-1]

    def at(self, time_s: float) -> float:
        k = bisect_right(self.time_s, time_s)
        if k == 0:
            return self.values_m[0]
        if k == len(self.time_s):
            return self.values_m[-1]
        share = (time_s - self.time_s[k - 1]) / (self.time_s[k] - self.time_s[k - 1])
        return self.values_m[k - 1] + share * (self.values_m[k] - self.values_m[k - 1])


def _um(*values: float) -> tuple[float, ...]:
    return tuple(value * 1e-6 for value in values)


REFERENCES: dict[str, dict[str, ReferenceSignal]] = {
    "integrated": {
        "steps": Steps(_um(20, 35, 50, 28, 42), 1.0),
        "sine": Multisine(30e-6, _um(15), (0.1,), 20.0),
        "multisine": Multisine(30e-6, _um(4, -6), (1.0, 10.0), 5.0),
    },
    "peltier": {
        "steps": Steps(_um(20, 35, 50), 15.0),
        "multisine": Multisine(35e-6, _um(8, 7, 5), (0.001, 0.005, 0.01), 1000.0),
    },
}
"""The reference signals of sections 7.4 (`integrated`) and 8.4 (`peltier`)."""
REFERENCES["peltier_chapter8"] = REFERENCES["peltier"]


def reference_signal(device: str, signal: str) -> ReferenceSignal:
    """Return the signal `steps`, `sine` or `multisine` of a shipped device.

    Raises
    ------
    ValueError : unknown device, or one without such a signal.
    """
    own = preset(device).id
    signals = REFERENCES.get(own, {})
    if signal not in signals:
        raise ValueError(
            f"signal: found {signal!r} for device {own}, need {', '.join(signals)}{', ' if signals else ''}steps.levels_m, "
            "multisine.amplitudes_m, csv with a file, or none"
        )
    return signals[signal]


def read_table(path: str | Path) -> Table:
    """Read a CSV with the header `time_s,tip_deflection` (s, m), any further columns left out.

    Parameters
    ----------
    path : of the file

    Returns
    -------
    Table : times [s] and deflections [m]

    Raises
    ------
    ValueError : unreadable, without these columns, or with a row that is not numeric; the message names the place.
    """
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.DictReader(stream))
    except OSError as error:
        raise ValueError(f"csv.file: {path} cannot be read ({error.strerror})") from error
    if not rows or not {"time_s", "tip_deflection"} <= set(rows[0]):
        found = ", ".join(rows[0]) if rows else "no row"
        raise ValueError(f"csv.file: {path} has {found}, need a header with time_s and tip_deflection")
    return Table(_column(rows, "time_s", path), _column(rows, "tip_deflection", path))


def _column(rows: Sequence[dict[str, str]], name: str, path: str | Path) -> tuple[float, ...]:
    values = []
    for line, row in enumerate(rows, start=2):
        try:
            values.append(float(row[name]))
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"csv.file: {path} line {line}: found {row[name]!r} in {name}, need a number"
            ) from error
    return tuple(values)
