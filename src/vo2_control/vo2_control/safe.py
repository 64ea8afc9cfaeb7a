"""The safe current: when a loop may hold, when it must let go, and how it comes back.

Plain logic around a `Controller`; the node feeds it samples and clock ticks and publishes what it decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

from vo2_models.units import shown_unit
from vo2_models.validation import positive_number

from vo2_control.controller import Controller

__all__ = ["OPEN", "Decision", "SafetySettings", "Supervisor"]

ABSURD = 10.0
"""Multiple of what the device reaches beyond which a deflection is as good as none."""
_NOT_FOLLOWED = "the measured current does not follow the command: the loop closes once it does"
Mode = Literal["idle", "starting", "tracking", "limited", "holding", "safe"]
OPEN: tuple[Mode, ...] = ("idle", "starting", "safe")
"""Modes without a closed loop: the controller starts anew from the present current with the sample that closes it."""


@dataclass(frozen=True)
class SafetySettings:
    """What counts as trustworthy input.

    Attributes
    ----------
    sample_period_s : [s]
    safe_current_a : where the loop goes when it may not go on [A]
    hold_periods : sample periods for which the last current is held without good input
    reach_m : lowest and highest deflection that the device reaches [m]; references are clipped to it
    wall_time : whether time passes, and the plant lets go, while no samples are answered
    unit, response_unit : of the drive and of the deflection, which stands for any response; for m in this file, too
    range_m : lowest and highest deflection by the device's file [m]
    """

    sample_period_s: float
    safe_current_a: float = 0.0
    hold_periods: int = 3
    reach_m: tuple[float, float] = (-math.inf, math.inf)
    wall_time: bool = False
    unit: str = "A"
    response_unit: str = "m"
    range_m: tuple[float, float] = (-1e9, 1e9)

    def __post_init__(self) -> None:
        positive_number(self.sample_period_s, "sample_period_s")
        if not math.isfinite(self.safe_current_a):
            raise ValueError(f"safe_current_a: found {self.safe_current_a}, need a finite current")
        if self.hold_periods < 0:
            raise ValueError(f"hold_periods: found {self.hold_periods}, need at least 0")
        low, high = self.reach_m
        if not low < high:
            raise ValueError(f"reach_m: found {low:g} to {high:g}, need lowest below highest")

    @property
    def absurd_m(self) -> float:
        """Magnitude [m] beyond which a deflection is as good as none."""
        low, high = self.range_m
        ends = [abs(end) for end in (low, high, high - low, *self.reach_m) if math.isfinite(end)]
        return ABSURD * max(ends)

    def shown(self, *values_m: float) -> str:
        """Return deflections [m] in words: "2.00 to 58.00 um"."""
        unit, factor = shown_unit(self.response_unit)
        digits = ".2f" if unit == "um" else ".4g"
        return f"{' to '.join(format(factor * value, digits) for value in values_m)} {unit}"


class Decision(NamedTuple):
    """A current [A] to publish, the mode of the loop, and why it is not plain tracking (else empty)."""

    current_a: float
    mode: Mode
    reason: str = ""


class Supervisor:
    """Runs a controller on good samples; holds, then goes to the safe current, on anything else.

    `sample` is called with every estimate, `lost` for every one that cannot be used or does not come. Neither raises
    on bad values: a loop under current must always get an answer.
    """

    def __init__(self, controller: Controller, settings: SafetySettings) -> None:
        self.settings = settings
        self._controller = controller
        self._current = settings.safe_current_a
        self._last_good_s = -math.inf
        self._mode: Mode = "idle"
        self._reason = "no estimate has arrived yet"

    @property
    def current_a(self) -> float:
        """The current decided last [A]."""
        return self._current

    @property
    def mode(self) -> Mode:
        return self._mode

    def begin_at(self, current_a: float) -> None:
        """Before the first sample: start without a bump from a current [A] that another node left flowing."""
        if self._mode == "idle" and math.isfinite(current_a):
            self._current = current_a

    def stand_by(self) -> None:
        """Leave the device to another node that commands it: the next sample begins as the first one did."""
        self._current, self._mode = self.settings.safe_current_a, "idle"

    def release(self, time_s: float, *, followed: bool) -> None:
        """Before a sample taken at `time_s` [s]: open a loop that the plant has left, so that it starts anew.

        It has left where it does not do what it is told (not `followed`), and, in wall time, where it got no commands
        for longer than it holds the last one.
        """
        left = not followed or (self.settings.wall_time and self._is_over(time_s))
        if left and self._mode not in OPEN:
            self._current, self._mode = self.settings.safe_current_a, "safe"

    def reachable(self, reference_m: float) -> float:
        """Return the reference clipped to the reach of the device [m]."""
        low, high = self.settings.reach_m
        return min(max(reference_m, low), high)

    def replace_controller(
        self, controller: Controller, reference_m: float, estimate_m: float, feedforward_a: float = 0.0
    ) -> None:
        """Hand over to another controller (a redesign) from the present current, without a bump."""
        if math.isfinite(reference_m) and math.isfinite(estimate_m):
            controller.reset(self._current, reference_m, estimate_m, feedforward_a)
        self._controller = controller

    def sample(
        self,
        time_s: float,
        reference_m: float,
        estimate_m: float,
        feedforward_a: float = 0.0,
        *,
        followed: bool = True,
    ) -> Decision:
        """Answer one sample taken at `time_s` [s].

        While the plant does not do what it is told (not `followed`), a loop that is open stays where it will start, and
        the controller's memory with it: an integrator must not wind up on a device that does not listen.
        """
        reference = self.reachable(reference_m)
        for name, given, used in (
            ("estimate", estimate_m, estimate_m),
            ("reference", reference_m, reference),
        ):
            if not (math.isfinite(given) and abs(used) < self.settings.absurd_m):
                return self._without_input(time_s, self._fault(name, given))
        if self._mode in OPEN:
            start = self._controller.reset(self._current, reference, estimate_m, feedforward_a)
            if not followed:
                self._current, self._last_good_s = start, time_s
                self._mode, self._reason = "starting", _NOT_FOLLOWED
                return Decision(self._current, self._mode, self._reason)
        self._current = self._controller.update(reference, estimate_m, feedforward_a)
        self._last_good_s = time_s
        self._mode, self._reason = "tracking", ""
        if reference != reference_m:
            shown = self.settings.shown
            self._mode = "limited"
            self._reason = f"reference of {shown(reference_m)} is outside the reachable {shown(*self.settings.reach_m)}: clipped"
        return Decision(self._current, self._mode, self._reason)

    def repeat(self, time_s: float) -> Decision:
        """Answer a good sample taken before the plant applied the last current: say it again, the controller waits."""
        self._last_good_s = time_s
        return Decision(self._current, self._mode, self._reason)

    def lost(self, time_s: float, why: str) -> Decision:
        """Answer a sample that cannot be used, `why` in the words of who found it: hold, then the safe current."""
        return self._without_input(time_s, why)

    def _is_over(self, time_s: float) -> bool:
        """Whether the last good sample is too long ago to hold on to it."""
        # half a period of slack, so that jitter of the clock does not cost a sample
        hold_s = (self.settings.hold_periods + 0.5) * self.settings.sample_period_s
        return time_s - self._last_good_s > hold_s

    def _without_input(self, time_s: float, fault: str) -> Decision:
        limit = self.settings.hold_periods
        if self._mode not in OPEN and not self._is_over(time_s):
            self._mode = "holding"
            self._reason = (
                f"{fault}: holding {self._current:.6g} {self.settings.unit} for at most {limit} samples"
            )
        else:
            self._current = self.settings.safe_current_a
            self._mode = "safe"
            self._reason = f"{fault}: safe current {self._current:.6g} {self.settings.unit}"
        return Decision(self._current, self._mode, self._reason)

    def _fault(self, name: str, value_m: float) -> str:
        """What is wrong with a value, the same words for all that are beyond the limit."""
        if not math.isfinite(value_m):
            return f"{name} is {value_m}"
        limit = self.settings.shown(self.settings.absurd_m)
        return f"{name} is beyond {limit}, {ABSURD:g} times what the device reaches: check its unit"
