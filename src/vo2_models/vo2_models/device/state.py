"""The memory of a running device: a few arrays that can be copied, saved and handed on."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum, auto

import numpy as np
from numpy.typing import NDArray

__all__ = ["CURRENT_LINE", "ChainState", "Slot"]

CURRENT_LINE = 4096
"""Length of the delay line of the current [samples]."""

Floats = NDArray[np.float64]


class Slot(IntEnum):
    """Index into the scalar memory; behind these stand the sensors' noise and the states of the effects."""

    def _generate_next_value_(name, start, count, last_values):  # type: ignore[override]
        return count

    STARTED = auto()  # 0 before the first sample
    SAMPLE = auto()  # number of the next sample
    CURRENT = auto()  # A, driver's last output
    FAST = auto()  # degC, state of the thermal model
    SLOW = auto()  # K, rise behind the slower lag
    STAGE = auto()  # degC, temperature of the heated body
    FILM = auto()  # degC
    CARRY = auto()  # K, enthalpy not yet turned into temperature or phase
    LAST_HEAT = auto()  # K, of the step before
    SLOPE = auto()  # 1/K, phase fraction per temperature in the step before
    RAW_R = auto()  # transition outputs, before what happens beside switching
    RAW_D = auto()
    EQUILIBRIUM_R = auto()  # what the transitions would have without kinetics
    EQUILIBRIUM_D = auto()
    OUT_R = auto()  # with what happens beside switching
    OUT_D = auto()
    REVERSIBLE_R = auto()  # what the laws have without hysteresis, where effects act on the phase; else 0
    REVERSIBLE_D = auto()
    FRACTION_R = auto()  # 1, switched share
    FRACTION_D = auto()
    LAST_CHANGE_R = auto()  # 1, of the fraction in the step before
    LAST_CHANGE_D = auto()
    HAS_R = auto()  # 1 where there is a law of the metallic transition
    HAS_D = auto()  # 1 where there is a law of the structural transition
    PREVIOUS_R = auto()  # degC, last inputs of the domain ensembles
    PREVIOUS_D = auto()
    COUNT_R = auto()  # domains switched
    COUNT_D = auto()
    RESISTANCE = auto()  # ohm
    LAG_RATE = auto()  # cached relaxation rate, and two steps with the decays that belong to them
    LAG_TIME = auto()
    LAG_STEP = auto()
    LAG_DECAY = auto()
    LAG_OTHER_STEP = auto()
    LAG_OTHER_DECAY = auto()
    COURSE = auto()  # what a course in time adds to the amplitude of the effect that has one


@dataclass
class ChainState:
    """Memory of one device.

    Attributes
    ----------
    scalars : (assembly.state_size(),) what `Slot` names, the coloured noise of each sensor, the states of all effects
    play_r, play_d : memories of the two laws, (1 + N,) for play banks (empty for the ensemble)
    metallic : (2, n) uint8, domains switched, metallic and structural (empty for the laws)
    line : (CURRENT_LINE,) delay line of the current [A]
    """

    scalars: Floats
    play_r: Floats
    play_d: Floats
    metallic: NDArray[np.uint8]
    line: Floats

    def copy(self) -> ChainState:
        """Return an independent copy."""
        return ChainState(**{field.name: getattr(self, field.name).copy() for field in fields(self)})
