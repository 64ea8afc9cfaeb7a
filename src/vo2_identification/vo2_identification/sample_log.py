"""Samples as they arrive, kept compactly, and as a `Recording` at the end."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np
from vo2_models.recording import COMMANDED_CURRENT, Recording

__all__ = ["SampleLog"]


class SampleLog:
    """Collects synchronous samples of fixed channels and the commands that answered them.

    Parameters
    ----------
    channels : names in the order of the values; a channel that never had a number is left out at the end
    """

    def __init__(self, channels: Sequence[str]) -> None:
        self.channels = tuple(channels)
        self._stamps_ns = array("q")
        self._values = array("d")
        self._commands_a = array("d")

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def append(self, stamp_ns: int, values: Sequence[float], command_a: float | None = None) -> None:
        """Add a sample and the command [A] that answered it, None where nothing was commanded."""
        self._stamps_ns.append(stamp_ns)
        self._values.extend(values)
        self._commands_a.append(float("nan") if command_a is None else command_a)

    def recording(self, device: str) -> Recording:
        """Return what was collected.

        The command that answered sample k - 1 flowed during the interval that ends at sample k, so it
        stands there as `commanded_current`; the first sample has none.

        Raises
        ------
        ValueError : fewer than two samples, or stamps that do not increase.
        """
        if len(self) < 2:
            raise ValueError(
                f"recording: found {len(self)} sample(s), need at least 2; is the plant running?"
            )
        stamps = np.array(self._stamps_ns, dtype=np.float64)
        table = np.array(self._values).reshape(len(self), len(self.channels))
        channels = {
            name: table[:, k].copy()
            for k, name in enumerate(self.channels)
            if not np.all(np.isnan(table[:, k]))
        }
        commands = np.array(self._commands_a)
        if not np.all(np.isnan(commands)):
            channels[COMMANDED_CURRENT] = np.concatenate([[np.nan], commands[:-1]])
        return Recording(stamps * 1e-9, channels, device)
