"""What the estimator runs: self-sensing from the resistance, or open-loop prediction from the drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from vo2_interface.topics import ESTIMATE_CHANNELS
from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.laws import law_from_parameters
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION
from vo2_models.self_sensing import KINDS, self_sensing
from vo2_models.self_sensing.memory import StreamingMemory
from vo2_models.self_sensing.records import BOUND_KNOTS

__all__ = ["DRIVE", "SCHEMES", "DriveScheme", "ResistanceScheme", "Scheme", "make_scheme"]

DRIVE = "drive"
SCHEMES = (*KINDS, DRIVE)


class Scheme(Protocol):
    """One measured channel in, the estimate's channels out.

    Attributes
    ----------
    input_channel : what it needs of the measurement
    need : which values of it are usable, in words
    channels : what it estimates
    note : what it does without, in words; empty if nothing
    period_s : sample period that its dynamics hold for [s]; 0 for a scheme without dynamics
    """

    input_channel: str
    need: str
    channels: tuple[str, ...]
    note: str
    period_s: float

    def usable(self, value: float) -> bool:
        """Whether the input can be used."""
        ...

    def step(self, value: float) -> tuple[float, ...]:
        """Advance one sample; return the values of `channels`."""
        ...

    def restart(self) -> None:
        """Forget: the next sample comes from a cold device."""
        ...

    def bridge(self) -> None:
        """Samples before the next one were lost."""
        ...

    def pass_time(self, step_s: float) -> None:
        """Take note of the time between the last sample that was used and the next one [s]."""
        ...

    @property
    def known(self) -> bool:
        """Whether its memory is known: no lost sample can matter any more."""
        ...


class ResistanceScheme:
    """Self-sensing: deflection, temperature surrogate and bound from the film resistance."""

    input_channel = RESISTANCE
    need = "finite ohm above 0"
    channels: tuple[str, ...] = ESTIMATE_CHANNELS

    def __init__(
        self, kind: str, parameters: Mapping[str, Value], resistance_range: tuple[float, float]
    ) -> None:
        scheme = self_sensing(kind, parameters)
        # only the scheme with dynamics has these; its module, with what it loads, stays where it is for the others
        mode = getattr(scheme, "mode", None)
        bounds = (
            ""
            if parameters.get(BOUND_KNOTS)
            else "the model has no error bounds, that of each estimate is NaN"
        )
        self.note = "; ".join(text for text in (scheme.doubt, getattr(scheme, "note", ""), bounds) if text)
        self.period_s: float = mode.period if mode is not None else 0.0
        self._memory = StreamingMemory(scheme, resistance_range)
        self.restart = self._memory.restart
        self.bridge = self._memory.bridge
        self.step = self._memory.step

    @property
    def known(self) -> bool:
        """Whether its memory is known: no lost sample can matter any more."""
        return self._memory.known

    def pass_time(self, step_s: float) -> None:
        """Its dynamics, where it has any, hold for one period."""

    def usable(self, value: float) -> bool:
        """Whether the resistance [ohm] can be used."""
        return math.isfinite(value) and value > 0.0


class DriveScheme:
    """Prediction of deflection and resistance from the drive, for rigs on which only one of them is measured.

    Raises
    ------
    ValueError : the model has neither law.
    """

    need = "a finite number"
    channels: tuple[str, ...] = (TIP_DEFLECTION, RESISTANCE)
    note = ""
    period_s = 0.0
    known = True

    def __init__(self, drive: str, parameters: Mapping[str, Value]) -> None:
        self.input_channel = drive
        self._laws = [_law(section, parameters) for section in ("model.deflection", "model.resistance")]
        if not any(self._laws):
            raise ValueError(
                "model.deflection, model.resistance: found no law over the drive, need one; run the identifier with "
                "drive_channel set"
            )
        self.restart()

    def restart(self) -> None:
        """Forget: the next sample comes from lower saturation."""
        self._states = [law.initial_memory() if law else np.empty(0) for law in self._laws]

    def pass_time(self, step_s: float) -> None:
        """Its laws know no time."""

    def bridge(self) -> None:
        """Samples before the next one were lost: it has no bound that could say so."""

    def usable(self, value: float) -> bool:
        """Whether the drive can be used."""
        return math.isfinite(value)

    def step(self, value: float) -> tuple[float, float]:
        """Return (deflection [m], resistance [ohm]) for the drive, NaN without its law."""
        deflection, resistance = (
            law.step(value, state) if law else math.nan
            for law, state in zip(self._laws, self._states, strict=True)
        )
        return deflection, 10.0**-resistance


def make_scheme(
    kind: str, drive: str, parameters: Mapping[str, Value], resistance_range: tuple[float, float]
) -> Scheme:
    """Return the scheme `kind` for flat `model.*` parameters.

    Parameters
    ----------
    drive : input of kind `drive` with a law that has no device around it
    resistance_range : lowest and highest resistance of the device in use [ohm]

    Raises
    ------
    ValueError : unknown kind, or a model that lacks what the scheme needs.
    """
    if kind == DRIVE and parameters.get("model.device"):
        from vo2_estimation.model_scheme import ModelScheme  # a whole simulation takes a while to load

        return ModelScheme(parameters)
    if kind == DRIVE:
        return DriveScheme(drive, parameters)
    return ResistanceScheme(kind, parameters, resistance_range)


def _law(section: str, parameters: Mapping[str, Value]) -> Law | None:
    law = law_from_parameters(section, parameters)
    if isinstance(law, PlayBank):
        return law.egpi() if law.present and np.size(law.weights) else None
    return law
