"""The memory of a running device: a few arrays that can be copied, saved and handed on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum, auto

import numpy as np
from numpy.typing import NDArray

__all__ = ["CURRENT_LINE", "SENSOR_LINE", "ChainState", "Slot"]

CURRENT_LINE = 4096
"""Length of the delay line of the current [samples]."""
SENSOR_LINE = 256
"""Length of the delay line of each sensor [samples]."""

Floats = NDArray[np.float64]


class Slot(IntEnum):
    """Index into the scalar memory."""

    def _generate_next_value_(name, start, count, last_values):  # type: ignore[override]
        return count

    STARTED = auto()  # 0 before the first sample
    SAMPLE = auto()  # number of the next sample
    CURRENT = auto()  # A, driver's last output
    HEAD = auto()  # place of the newest current in its delay line
    FAST = auto()  # degC, state of the fast thermal mode
    SLOW = auto()  # K, state of the slow thermal mode
    STAGE = auto()  # degC, temperature of the heated body
    FILM = auto()  # degC
    CARRY = auto()  # K, enthalpy not yet turned into temperature or phase
    LAST_HEAT = auto()  # K, of the step before
    LAST_CHANGE = auto()  # 1, of the phase fraction in the step before
    SLOPE = auto()  # 1/K, phase fraction per temperature in the step before
    RAW_R = auto()  # transition outputs, before relaxation and reversible part
    RAW_D = auto()
    EQUILIBRIUM_R = auto()  # what the transitions would have without kinetics
    EQUILIBRIUM_D = auto()
    OUT_R = auto()  # after relaxation and reversible part
    OUT_D = auto()
    FRACTION = auto()  # of the leading transition
    PREVIOUS_R = auto()  # degC, last inputs of the domain ensembles
    PREVIOUS_D = auto()
    COUNT_R = auto()  # domains switched
    COUNT_D = auto()
    RESISTANCE = auto()  # ohm
    TURN = auto()  # degC, extreme since the last reversal
    DIRECTION = auto()  # +1 heating, -1 cooling, 0 not yet known
    REVERSALS = auto()
    ANCHOR = auto()  # degC, of the step before, for the way the film moves
    WAY = auto()  # +1 heated, -1 cooled, 0 not moved yet: the last motion that was no hold
    RELAXED = auto()  # 1, after-effect, ln(1 + t / t0) at rest
    BAND = auto()  # degC, centre of the reversible band
    CREPT = auto()  # m
    MODE = auto()  # m, displacement of the mode
    MODE_RATE = auto()  # m per rad of the mode
    MODE_INPUT = auto()  # m
    LAG_RATE = auto()  # cached relaxation rate and the decay that belongs to it
    LAG_TIME = auto()
    LAG_STEP = auto()
    LAG_DECAY = auto()


@dataclass
class ChainState:
    """Memory of one device.

    Attributes
    ----------
    scalars : (len(Slot),)
    play_r, play_d : (1 + N,) memories of the two play banks (empty for the ensemble)
    metallic : (2, n) uint8, domains switched, metallic and structural (empty for the play banks)
    line : (CURRENT_LINE,) delay line of the current [A]
    sensors : (4, 3) lag state, coloured noise and last input of each sensor
    sensor_lines : (4, SENSOR_LINE)
    """

    scalars: Floats
    play_r: Floats
    play_d: Floats
    metallic: NDArray[np.uint8]
    line: Floats
    sensors: Floats
    sensor_lines: Floats

    def copy(self) -> ChainState:
        """Return an independent copy."""
        return ChainState(**{field.name: getattr(self, field.name).copy() for field in fields(self)})
