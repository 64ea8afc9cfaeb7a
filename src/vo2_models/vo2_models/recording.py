"""A recording in memory: synchronous samples of named channels, as one bag or one run holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.validation import finite_array, increasing

__all__ = [
    "COMMANDED_CURRENT",
    "HEATER_CURRENT",
    "RESISTANCE",
    "STAGE_TEMPERATURE",
    "TIP_DEFLECTION",
    "Recording",
    "aligned",
]

HEATER_CURRENT = "heater_current"
"""Current through the heater as the rig logs it [A]."""
COMMANDED_CURRENT = "commanded_current"
"""What the controller asked for over the interval that ends at the sample [A]; from the command topic."""
RESISTANCE = "film_resistance"
"""Film resistance [ohm]."""
TIP_DEFLECTION = "tip_deflection"
"""Tip deflection by an external sensor [m]."""
STAGE_TEMPERATURE = "stage_temperature"
"""Temperature of the Peltier stage [degC]."""


@dataclass(frozen=True)
class Recording:
    """Samples of one device.

    The current convention is that of a zero-order hold seen by a data logger: element k of a current
    channel flowed during the interval that *ends* at `time_s[k]`; the other channels are what was
    sampled at `time_s[k]`.

    Attributes
    ----------
    time_s : (n,) stamps [s], strictly increasing
    channels : name -> (n,) values in SI units (degree Celsius for temperatures); NaN where a sample of
        a channel is missing
    device : preset id, as in `header.frame_id`; empty where unknown
    """

    time_s: NDArray[np.float64]
    channels: Mapping[str, NDArray[np.float64]]
    device: str = ""

    def __post_init__(self) -> None:
        time = increasing(finite_array(self.time_s, "time_s"), "time_s")
        object.__setattr__(self, "time_s", time)
        checked = {}
        for name, values in self.channels.items():
            array = np.ascontiguousarray(values, dtype=np.float64)
            if array.shape != time.shape:
                raise ValueError(
                    f"channel {name}: found shape {array.shape}, need {time.shape} as time_s has"
                )
            checked[name] = array
        object.__setattr__(self, "channels", checked)

    def __len__(self) -> int:
        return self.time_s.size

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return the channel `name` (n,); raise `KeyError` naming what there is instead."""
        if name not in self.channels:
            raise KeyError(
                f"channel {name} is not in this recording, which has {', '.join(self.channels) or 'none'}"
            )
        return self.channels[name]

    @property
    def sample_period_s(self) -> float:
        """Median distance of neighbouring stamps [s]; robust against gaps."""
        return float(np.median(np.diff(self.time_s)))

    def slice(self, start: int, stop: int) -> Recording:
        """Return samples start..stop-1 as a recording of their own."""
        return replace(
            self,
            time_s=self.time_s[start:stop],
            channels={name: values[start:stop] for name, values in self.channels.items()},
        )


def aligned(recording: Recording, delay: float) -> Recording:
    """Return the recording with each command moved to the interval that it governed.

    A rig may stamp a command at the end of the interval it governs (delay: minus one sample period) or apply it late by a
    constant. Element k of `commanded_current` becomes the mean of the held command over the interval that ends at
    `time_s[k]`, moved back by the delay. Before the first command it stays NaN.

    Parameters
    ----------
    delay : time from where a command stands in the recording to where it acts [s], `model.recording.command_delay`
    """
    if delay == 0.0 or COMMANDED_CURRENT not in recording or len(recording) < 2:
        return recording
    command, time = recording[COMMANDED_CURRENT], recording.time_s
    known = np.flatnonzero(np.isfinite(command))
    if not known.size:
        return recording
    first = int(known[0])
    last = np.maximum(np.searchsorted(known, np.arange(command.size), side="right") - 1, 0)
    held = command[known[last]]
    ends = np.concatenate([[2.0 * time[0] - time[1]], time])
    charge = np.concatenate([[0.0], np.cumsum(held * np.diff(ends))])

    def integral(at: NDArray[np.float64]) -> NDArray[np.float64]:
        beyond = held[0] * np.minimum(at - ends[0], 0.0) + held[-1] * np.maximum(at - ends[-1], 0.0)
        return np.interp(at, ends, charge) + beyond

    moved = (integral(ends[1:] - delay) - integral(ends[:-1] - delay)) / np.diff(ends)
    if first:
        moved[time - delay < time[first]] = np.nan
    return replace(recording, channels={**recording.channels, COMMANDED_CURRENT: moved})
