"""What a benchmark is and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Entry", "Figure"]


@dataclass(frozen=True)
class Figure:
    """One measured figure.

    Attributes
    ----------
    value : the figure in `unit`
    unit : ns (per sample), us (per sample), s, samples/s, bytes, arrays, or lines
    yardstick : the same figure of the yardstick in the same run; None where there is none
    note : one remark for the table, such as what the yardstick is
    """

    value: float
    unit: str
    yardstick: float | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """value / yardstick, None without one."""
        return self.value / self.yardstick if self.yardstick else None

    def record(self) -> dict[str, float | str | None]:
        """The machine-readable form: value, unit, yardstick, ratio."""
        return {"value": self.value, "unit": self.unit, "yardstick": self.yardstick, "ratio": self.ratio}


@dataclass(frozen=True)
class Entry:
    """One benchmark.

    Attributes
    ----------
    name : as in the JSON file
    run : measures and returns the figure; warms up by itself
    target : the figure asked for
    of : whether the target bounds the "value" or the "ratio"
    above : True where the figure should be at least the target instead of at most
    on_request : True for one that takes minutes: measured only where it is named
    """

    name: str
    run: Callable[[], Figure]
    target: float | None = None
    of: str = "value"
    above: bool = False
    on_request: bool = False

    def met(self, figure: Figure) -> bool | None:
        """Whether the figure meets the target; None without one."""
        found = figure.ratio if self.of == "ratio" else figure.value
        if self.target is None or found is None:
            return None
        return found >= self.target if self.above else found <= self.target
