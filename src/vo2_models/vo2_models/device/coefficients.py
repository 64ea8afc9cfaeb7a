"""The coefficient vector of the chain: every number the compiled loop reads, by name.

A device, or an effect, is a set of values in this vector. `neutral()` switches every effect off: with a
neutral value a term contributes exactly nothing (it is multiplied by zero, added as zero, or its branch is
not taken).
"""

from __future__ import annotations

from enum import IntEnum, auto

import numpy as np
from numpy.typing import NDArray

from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = [
    "BEHIND_FILM",
    "CHANNELS",
    "FEEDBACK",
    "HUGE",
    "PER_CHANNEL",
    "Coefficient",
    "Sensor",
    "neutral",
    "sensor_index",
]

HUGE = 1e12
"""Stands for "no limit" in a coefficient (a model file holds finite numbers only)."""


class Coefficient(IntEnum):
    """Index of a coefficient of the chain before the sensors; units in the comments."""

    def _generate_next_value_(name, start, count, last_values):  # type: ignore[override]
        return count

    SAMPLE_PERIOD = auto()  # s
    SUBSTEPS = auto()  # 1: thermal steps per sample
    FEEDBACK = auto()  # 1 where the phase acts back on the heat or on itself, else 0
    # driver
    RANGE_LOW = auto()  # A: the source's own range
    RANGE_HIGH = auto()  # A
    SATURATION = auto()  # A: |i| at most
    SLEW = auto()  # A/s
    DEADZONE = auto()  # A
    DEAD_TIME = auto()  # s
    # heat
    AMBIENT = auto()  # degC
    LINEAR_GAIN = auto()  # K/A
    SQUARE_GAIN = auto()  # K/A^2
    PUMPING = auto()  # 1/A: Peltier term current * (T - T0)
    HEATER_TCR = auto()  # 1/K
    TIME_CONSTANT = auto()  # s
    COOLING_RATIO = auto()  # 1: time constant of cooling = (1 + ratio) of heating
    SLOW_SHARE = auto()  # 1: part of the gain that arrives through the slow mode
    SLOW_TIME = auto()  # s
    SLOW_GAIN = auto()  # 1: change of the steady gain that comes with the slow mode
    LOSS = auto()  # K^(1 - exponent)
    LOSS_EXPONENT = auto()  # 1
    PHASE_LOSS = auto()  # 1
    LATENT = auto()  # K
    METALLIC_LEADS = auto()  # 1: whether the metallic transition stands for the phase in heat
    DRIFT_RATE = auto()  # K/s
    DRIFT_CURVATURE = auto()  # K/s^2
    LASER = auto()  # K: of the whole film, through the thermal dynamics
    LASER_FILM = auto()  # K: of the film above its stage, at once
    LASER_FROM = auto()  # s
    LASER_UNTIL = auto()  # s
    SENSE = auto()  # K/ohm: self-heating through the thermal dynamics
    SENSE_FILM = auto()  # K/ohm: of the film above its stage
    # transitions
    TRANSITION_OFFSET = auto()  # K: the structural transition sees T + offset
    INCONGRUENCY = auto()  # K
    TRAINING = auto()  # K per reversal
    TRAINING_EXCURSION = auto()  # K: smaller turns do not count
    KINETICS = auto()  # s
    RELAXATION = auto()  # 1
    RELAXATION_TIME = auto()  # s
    RELAXATION_TRAVEL = auto()  # K
    REVERSIBLE = auto()  # 1/K
    REVERSIBLE_BAND = auto()  # K
    REVERSIBLE_SHARE = auto()  # 1
    # resistance
    SERIES = auto()  # ohm
    LEAKAGE = auto()  # S
    CROSSTALK = auto()  # ohm/A
    # deflection
    HOT_EXPANSION = auto()  # m/K
    CREEP = auto()  # 1
    CREEP_TIME = auto()  # s
    CREEP_GAIN = auto()  # 1: change of the resting deflection that comes with creep
    MODE_SHARE = auto()  # 1
    MODE_FREQUENCY = auto()  # Hz
    MODE_DAMPING = auto()  # 1
    # laws of the two members of the hysteresis interface
    INSULATOR = auto()  # ohm at REFERENCE_LOW
    REFERENCE_LOW = auto()  # degC
    ACTIVATION = auto()  # K: activation energy over Boltzmann's constant
    METAL = auto()  # ohm at REFERENCE_HIGH
    REFERENCE_HIGH = auto()  # degC
    METAL_SLOPE = auto()  # 1/K, decades of resistance lost per kelvin
    THRESHOLD = auto()  # 1: percolation threshold
    CURVATURE = auto()  # 1/m at AMBIENT, insulating
    BENDING = auto()  # 1/m: curvature of the whole phase transition
    EXPANSION_COLD = auto()  # 1/(m K)
    EXPANSION_HOT = auto()  # 1/(m K)
    LENGTH = auto()  # m
    DEFLECTION_ZERO = auto()  # m
    PLAY_LOW_R = auto()  # span of the weighted play sums, for phase fractions
    PLAY_HIGH_R = auto()
    PLAY_LOW_D = auto()
    PLAY_HIGH_D = auto()


class Sensor(IntEnum):
    """Index of a coefficient within the block of one channel's sensor."""

    def _generate_next_value_(name, start, count, last_values):  # type: ignore[override]
        return count

    LAG = auto()  # s
    CLOCK = auto()  # s: the value is this much older than its stamp
    DRIFT = auto()  # 1/s
    NOISE = auto()  # 1 s.d., channel unit
    NOISE_RELATIVE = auto()  # 1 s.d., share of the value
    COLOUR = auto()  # 1: AR(1) coefficient of the noise
    STEP = auto()  # channel unit: quantisation
    LOW = auto()  # channel unit
    HIGH = auto()  # channel unit
    IDEAL = auto()  # 1 where all of the above are neutral, so that the sensor can be passed over


CHANNELS = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
"""Channels that have a sensor block, in its order."""
PER_CHANNEL = len(Sensor)

_NEUTRAL = {
    Coefficient.SAMPLE_PERIOD: 1e-3,
    Coefficient.SUBSTEPS: 1.0,
    Coefficient.RANGE_LOW: -HUGE,
    Coefficient.RANGE_HIGH: HUGE,
    Coefficient.SATURATION: HUGE,
    Coefficient.SLEW: HUGE,
    Coefficient.TIME_CONSTANT: 1.0,
    Coefficient.SLOW_TIME: 1.0,
    Coefficient.LASER_FROM: -HUGE,
    Coefficient.LASER_UNTIL: HUGE,
    Coefficient.LOSS_EXPONENT: 2.0,
    Coefficient.TRAINING_EXCURSION: 2.0,
    Coefficient.RELAXATION_TIME: 1.0,
    Coefficient.RELAXATION_TRAVEL: 0.5,
    Coefficient.REVERSIBLE_BAND: 1.0,
    Coefficient.CREEP_TIME: 1.0,
    Coefficient.MODE_FREQUENCY: 1.0,
    Coefficient.MODE_DAMPING: 0.02,
    Coefficient.THRESHOLD: 0.5,
    Coefficient.LENGTH: 1.0,
    Coefficient.INSULATOR: 1.0,
    Coefficient.METAL: 1.0,
    Coefficient.PLAY_HIGH_R: 1.0,
    Coefficient.PLAY_HIGH_D: 1.0,
}


FEEDBACK = (
    Coefficient.PUMPING,
    Coefficient.HEATER_TCR,
    Coefficient.LOSS,
    Coefficient.PHASE_LOSS,
    Coefficient.LATENT,
    Coefficient.SENSE,
    Coefficient.SENSE_FILM,
    Coefficient.INCONGRUENCY,
    Coefficient.KINETICS,
    Coefficient.RELAXATION,
    Coefficient.REVERSIBLE,
    Coefficient.REVERSIBLE_SHARE,
    Coefficient.SLOW_SHARE,
)
"""Coefficients that, when not zero, make the exact one-step solution of the linear thermal model insufficient."""


BEHIND_FILM = tuple(Coefficient)[Coefficient.SERIES : Coefficient.MODE_DAMPING + 1]
"""Coefficients of terminals and structure: the film, its temperature and its phase do not feel them."""


def sensor_index(channel: str, coefficient: Sensor) -> int:
    """Return the place of a sensor coefficient; raise a `ValueError` for a channel without sensor."""
    if channel not in CHANNELS:
        raise ValueError(f"signal: found {channel!r}, need one of {', '.join(CHANNELS)}")
    return len(Coefficient) + CHANNELS.index(channel) * PER_CHANNEL + int(coefficient)


def neutral() -> NDArray[np.float64]:
    """Return a coefficient vector in which every effect is off and no noise is added."""
    vector = np.zeros(len(Coefficient) + len(CHANNELS) * PER_CHANNEL)
    for index, value in _NEUTRAL.items():
        vector[index] = value
    for channel in CHANNELS:
        vector[sensor_index(channel, Sensor.LOW)] = -HUGE
        vector[sensor_index(channel, Sensor.HIGH)] = HUGE
    return vector
