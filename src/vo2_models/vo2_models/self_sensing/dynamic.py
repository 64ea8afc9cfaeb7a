"""Rate-dependent composite self-sensing: the composite scheme, then a lightly damped mode of the cantilever.

The film's resistance follows the film's own temperature, so the inverse of the resistance law already carries the
thermal state: what it finds is the temperature of this moment. What the static scheme lacks is the structure between
bending moment and tip, section 7.2.1. Without identified mode the scheme is the static composite and says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.mode import mode_step
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import BankShape
from vo2_models.numerics.kernel import kernel
from vo2_models.parameters import Value
from vo2_models.self_sensing.bounds import bound_table
from vo2_models.self_sensing.composite import CompositeSelfSensing
from vo2_models.self_sensing.mode_fit import ModeFit, fit_law_through_mode, fit_mode
from vo2_models.self_sensing.records import COMPOSITE, MODE
from vo2_models.self_sensing.scheme import SelfSensing

__all__ = ["DynamicSelfSensing", "mode_parameters"]

Floats = NDArray[np.float64]

_MEMORY = 4
"""z [m], z' / w [m], last static deflection [m], whether there was a sample."""
_JITTER = 0.1
"""Largest deviation of a sample interval, relative, for a recording to count as evenly sampled."""


@kernel
def advance_mode(static, step, share, memory):
    """Deflection [m] with the mode after the next static one; `memory` (4,) is updated in place.

    The first sample finds the mode at rest.
    """
    if memory[3] == 0.0:
        memory[0], memory[1], memory[2], memory[3] = static, 0.0, static, 1.0
        return static
    z, rate, last = memory[0], memory[1], memory[2]
    memory[0] = step[0, 0] * z + step[0, 1] * rate + step[0, 2] * last + step[0, 3] * static
    memory[1] = step[1, 0] * z + step[1, 1] * rate + step[1, 2] * last + step[1, 3] * static
    memory[2] = static
    return (1.0 - share) * static + share * memory[0]


@dataclass(frozen=True, eq=False)
class DynamicSelfSensing(SelfSensing):
    """Composite scheme followed by a mode; it must be fed once every sample period.

    Parameters
    ----------
    static : the composite scheme, with the table of bounds of this one
    mode : None makes it the static scheme
    note : why there is no mode; empty with one
    """

    kind = "dynamic"

    static: CompositeSelfSensing
    mode: ModeFit | None = None
    note: str = ""
    _step: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        step = np.zeros((2, 4))
        if self.mode is not None:
            step = mode_step(self.mode.frequency, self.mode.damping, self.mode.period)
        object.__setattr__(self, "_step", step)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> DynamicSelfSensing:
        frequency, damping, share, period = (
            float(parameters.get(f"{MODE}.{name}", 0.0))  # type: ignore[arg-type]
            for name in ("frequency", "damping", "share", "sample_period")
        )
        if min(frequency, share, period) <= 0.0:
            why = str(parameters.get(f"{MODE}.note", "")) or "the model file holds no mode"
            note = f"dynamics unidentified, the estimate is the static composite's: {why}"
            return cls(CompositeSelfSensing.from_parameters(parameters), None, note)
        if frequency >= 0.5 / period:
            raise ValueError(
                f"{MODE}.frequency: found {frequency:g} Hz, need less than half the sampling rate, "
                f"{0.5 / period:g} Hz"
            )
        law = PlayBank.from_parameters(f"{MODE}.deflection", parameters)
        own = law.to_parameters(f"{COMPOSITE}.deflection") if law.present else {}
        plain = CompositeSelfSensing.from_parameters({**parameters, **own})
        static = CompositeSelfSensing(
            plain.device, plain.resistance, plain.deflection, bound_table(cls.kind, parameters)
        )
        return cls(static, ModeFit(frequency, damping, share, period, float("nan")))

    def initial_state(self) -> Floats:
        memory = self.static.initial_state()
        return memory if self.mode is None else np.concatenate([memory, np.zeros(_MEMORY)])

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        if self.mode is None:
            return self.static.step(resistance, state)
        tip, temperature, surrogate, bound = self.static.step(resistance, state[:-_MEMORY])
        if tip != tip:  # no number came in: the static scheme kept its memory, so does the mode
            return tip, temperature, surrogate, bound
        return (
            advance_mode(tip, self._step, self.mode.share, state[-_MEMORY:]),
            temperature,
            surrogate,
            bound,
        )


def mode_parameters(
    time_s: Floats | None, resistance: Floats, deflection: Floats, parameters: Mapping[str, Value]
) -> dict[str, Value]:
    """Return the flat `model.self_sensing.mode.*` parameters that a recording supports.

    Parameters
    ----------
    time_s : (n,) stamps [s], None where samples are missing, which leaves the mode unidentified
    resistance, deflection : (n,) [ohm], [m]
    parameters : flat `model.*` parameters of the fitted laws
    """
    mode, law, note = None, PlayBank(), ""
    intervals = np.diff(time_s) if time_s is not None and time_s.size > 1 else np.zeros(0)
    period = float(np.median(intervals)) if intervals.size else 0.0
    if time_s is None:
        note = "samples of the recording are missing"
    elif not intervals.size or np.max(np.abs(intervals - period)) > _JITTER * period:
        note = "the recording is not evenly sampled"
    else:
        found, _ = CompositeSelfSensing.from_parameters(parameters).estimate(resistance)
        mode, note = fit_mode(np.asarray(found.deflection), deflection, period)
        bank = PlayBank.from_parameters("model.deflection", parameters)
        if mode is not None and _refittable(bank):
            better = fit_law_through_mode(
                np.asarray(found.temperature), deflection, BankShape.of_bank(bank), mode
            )
            if better is not None:
                law, mode = better[0].bank(), better[1]
    return {
        f"{MODE}.frequency": mode.frequency if mode else 0.0,
        f"{MODE}.damping": mode.damping if mode else 0.0,
        f"{MODE}.share": mode.share if mode else 0.0,
        f"{MODE}.sample_period": mode.period if mode else 0.0,
        f"{MODE}.note": note,
        **law.to_parameters(f"{MODE}.deflection"),
    }


def _refittable(bank: PlayBank) -> bool:
    """Whether the law has the form that the fit writes; one given by hand stays as it is."""
    return (
        not np.any(bank.radii)
        and np.allclose(bank.rising_slopes, bank.falling_slopes)
        and bool(np.all(np.asarray(bank.weights) > 0.0))
    )
