"""The coefficient vector of the chain: every number that the compiled loop reads, by name.

First the constants of the device, then the noise of each channel's sensor, then a block for each effect (for each
channel that it can sit on): whether it is on, its parameters, and the numbers of its `prepare`. The blocks are
numbered here from the effect files; nothing else lists them. `neutral()` switches every effect off: what is off is
passed over and contributes exactly nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, auto
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = [
    "CHANNELS",
    "HUGE",
    "Block",
    "Coefficient",
    "Sensor",
    "apply_effects",
    "blocks",
    "first_flag",
    "neutral",
    "sensor_index",
    "size",
]

Floats = NDArray[np.float64]
HUGE = 1e12
"""Stands for "no limit" in a coefficient (a model file holds finite numbers only)."""


class Coefficient(IntEnum):
    """Index of a constant of the device, or of what the compiled loop is told beside; units in the comments."""

    def _generate_next_value_(name, start, count, last_values):  # type: ignore[override]
        return count

    SAMPLE_PERIOD = auto()  # s
    SUBSTEPS = auto()  # 1: thermal steps per sample
    FEEDBACK = (
        auto()
    )  # 1 where the exact one-step solution of the linear thermal model does not suffice, else 0
    FOLLOWS = (
        auto()
    )  # 1 where the last input of the transitions and the turns on the way are all that decides
    CLOCK = auto()  # 1: how fast the effects' own time goes; 0 while the device is brought to rest
    # driver
    RANGE_LOW = auto()  # A: the source's own range
    RANGE_HIGH = auto()  # A
    DEAD_TIME = auto()  # s
    # heat
    AMBIENT = auto()  # degC
    LINEAR_GAIN = auto()  # K/A
    SQUARE_GAIN = auto()  # K/A^2
    TIME_CONSTANT = auto()  # s
    BETWEEN = (
        auto()
    )  # s: time constant with which a response moves on between two samples; HUGE where it goes straight
    POWER_GAIN = auto()  # K/W: rise per electrical power in the film itself
    VOLTAGE = auto()  # 1 where the drive is the voltage over the film, 0 where it is the current through it
    SLOW_SHARE = auto()  # 1: part of the rise that arrives through a second, slower lag
    SLOW_TIME = auto()  # s
    ON_STAGE = auto()  # 1 where the film sits on a heated stage that has a temperature of its own
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
    HELD = auto()  # 1 where the drive of a device without heat is known to be held over a sample


class Sensor(IntEnum):
    """Index of a coefficient within the block of one channel's sensor."""

    def _generate_next_value_(name, start, count, last_values):  # type: ignore[override]
        return count

    NOISE = auto()  # 1 s.d., channel unit
    NOISE_RELATIVE = auto()  # 1 s.d., share of the value
    COLOUR = auto()  # 1: AR(1) coefficient of the noise
    IDEAL = (
        auto()
    )  # 1 where there is no noise and no effect on the channel, so that the sensor can be passed over


CHANNELS = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
"""Channels that have a sensor block, in its order."""
FLAGS = 32
"""Room for the flags of `device.assembly`."""
_NEUTRAL = {
    Coefficient.SAMPLE_PERIOD: 1e-3,
    Coefficient.SUBSTEPS: 1.0,
    Coefficient.CLOCK: 1.0,
    Coefficient.RANGE_LOW: -HUGE,
    Coefficient.RANGE_HIGH: HUGE,
    Coefficient.TIME_CONSTANT: 1.0,
    Coefficient.BETWEEN: 1.0,
    Coefficient.SLOW_TIME: 1.0,
    Coefficient.THRESHOLD: 0.5,
    Coefficient.LENGTH: 1.0,
    Coefficient.INSULATOR: 1.0,
    Coefficient.METAL: 1.0,
    Coefficient.PLAY_HIGH_R: 1.0,
    Coefficient.PLAY_HIGH_D: 1.0,
}


@dataclass(frozen=True)
class Block:
    """Where an effect stands in the coefficient vector and in the scalar memory.

    Attributes
    ----------
    effect, signal : id, and the channel it sits on (empty for an effect on no single channel)
    active : place of the number that says whether it is on
    places : name of a parameter or of a number of `prepare` -> place
    states : name of a state -> first place in the scalar memory, counted from the end of the chain's own
    """

    effect: str
    signal: str
    active: int
    places: Mapping[str, int]
    states: Mapping[str, int]


def sensor_index(channel: str, coefficient: Sensor) -> int:
    """Return the place of a sensor coefficient; raise a `ValueError` for a channel without sensor."""
    if channel not in CHANNELS:
        raise ValueError(f"signal: found {channel!r}, need one of {', '.join(CHANNELS)}")
    return len(Coefficient) + CHANNELS.index(channel) * len(Sensor) + int(coefficient)


def first_flag() -> int:
    """Return the place of the first flag of `device.assembly`."""
    return len(Coefficient) + len(CHANNELS) * len(Sensor)


@cache
def blocks() -> Mapping[str, Block]:
    """Return the blocks of all effects by `id`, or by `id:channel` for each channel that an effect can sit on."""
    from vo2_models.effects import effects

    found: dict[str, Block] = {}
    place = first_flag() + FLAGS
    state = 0
    for record in effects().values():
        for signal in record.channels if record.signal else ("",):
            names = [*(p.name for p in record.parameters), *record.derived]
            places = {name: place + 1 + k for k, name in enumerate(names)}
            states = {}
            for each in record.states:
                states[each.name] = state
                state += each.size
            key = f"{record.id}:{signal}" if signal else record.id
            found[key] = Block(record.id, signal, place, places, states)
            place += 1 + len(names)
    return found


@cache
def size() -> int:
    """Return the length of the coefficient vector."""
    last = max(blocks().values(), key=lambda block: block.active)
    return max(last.active, *last.places.values()) + 1


@cache
def _neutral() -> Floats:
    from vo2_models.effects import effects

    vector = np.zeros(size())
    for index, value in _NEUTRAL.items():
        vector[index] = value
    for block in blocks().values():
        for name, value in effects()[block.effect].neutral().items():
            vector[block.places[name]] = value
    return vector


def neutral() -> Floats:
    """Return a coefficient vector in which every effect is off and no noise is added."""
    return _neutral().copy()


def apply_effects(c: Floats, values: Mapping[str, Mapping[str, float | str]], *, device: str) -> None:
    """Write effects into a coefficient vector.

    Parameters
    ----------
    c : coefficients, changed in place
    values : id -> parameter -> value in its unit, and "signal" -> channel; an id may be followed by ":" and a word, so that
        one effect can sit on several signals
    device : id, path or text of the device, see `preset`

    Raises
    ------
    ValueError : unknown effect or parameter, value out of range, effect that cannot occur on the device.
    """
    from vo2_models.device.description import preset
    from vo2_models.effects import effect
    from vo2_models.effects.magnitude import lacks

    for key, given in values.items():
        record = effect(key.split(":")[0])
        if not record.occurs_on(device):
            described = preset(device)
            raise ValueError(
                f"{record.id}: cannot occur on device {described.id}: it lacks {lacks(record, described)}"
            )
        complete, signal = record.complete(given)
        block = blocks()[f"{record.id}:{signal}" if signal else record.id]
        neutral_values = record.neutral()
        for name, value in complete.items():
            c[block.places[name]] = value
        c[block.active] = float(any(value != neutral_values[name] for name, value in complete.items()))
