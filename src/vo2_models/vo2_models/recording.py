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
