"""The same physics with other constants: what another day does to a rig, and one constant that has moved for good.

A shift of the film's transition is none of them: it is the room's where no thermometer tells, and elsewhere the steady
heat of a laser, which is an effect of the catalogue. Nor is the dead time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

from vo2_studies.challenge.devices import Device
from vo2_studies.challenge.effect import either_sign, log_uniform

__all__ = ["CONSTANTS", "Constant", "another_day", "draw_move", "names_constant"]


@dataclass(frozen=True)
class Constant:
    """A constant of the device.

    Attributes
    ----------
    name, unit : as answers have it; unit "1" for a factor
    size : smallest and largest visible move, in the unit
    move : (device, by) -> device with the constant moved
    called : pattern of the names under which a diagnosis may report it
    """

    name: str
    unit: str
    size: tuple[float, float]
    move: Callable[[Device, float], Device]
    called: str


def _scaled(field: str) -> Callable[[Device, float], Device]:
    return lambda device, by: replace(device, **{field: getattr(device, field) * (1 + by)})


def _resistance(device: Device, by: float) -> Device:
    decades = float(np.log10(1 + by))
    return replace(device, log_cold=device.log_cold + decades, log_hot=device.log_hot + decades)


def _deflection(device: Device, by: float) -> Device:
    fields = ("strain", "expansion_cold", "expansion_hot", "rest")
    return replace(device, **{name: getattr(device, name) * (1 + by) for name in fields})


def _zero(device: Device, by: float) -> Device:
    return replace(
        device, rest=device.rest + by * (device.preset.deflection[1] - device.preset.deflection[0])
    )


_AMBIENT = r"ambient|room|surround|base_temperature"
CONSTANTS = (
    # a room that is warmer and a film that switches earlier are one thing where no thermometer tells
    Constant(
        "ambient",
        "K",
        (0.8, 4.0),
        lambda d, by: replace(d, ambient=d.ambient + by),
        _AMBIENT + r"|transition|threshold|middle",
    ),
    Constant(
        "heat_gain", "1", (0.015, 0.08), _scaled("gain"), r"linear_gain|square_gain|heat.*gain|thermal.*gain"
    ),
    Constant("time_constant", "1", (0.08, 0.3), _scaled("time_constant"), r"time_const|tau"),
    Constant(
        "film_scale",
        "1",
        (0.02, 0.15),
        _resistance,
        rf"(resist|film|{RESISTANCE}).*(scale|gain|offset|level|factor)",
    ),
    Constant(
        "deflection_scale",
        "1",
        (0.01, 0.08),
        _deflection,
        rf"(deflection|tip|lever|{TIP_DEFLECTION}).*(scale|gain|factor|sensitiv)",
    ),
    Constant(
        "deflection_zero",
        "of range",
        (0.006, 0.04),
        _zero,
        rf"(deflection|tip|lever|{TIP_DEFLECTION}).*(zero|offset|rest|level|bias)",
    ),
)


def draw_move(rng: np.random.Generator, constant: Constant) -> float:
    """Draw how far `constant` moves, in its unit."""
    return either_sign(rng, log_uniform(rng, *constant.size))


def another_day(rng: np.random.Generator, device: Device) -> tuple[Device, dict[str, float]]:
    """Return the device on another day and what is other: room [K], deflection's zero [m], time constant [1].

    The room is 0.3 to 0.7 K off, the zero a five-hundredth of the preset's range (0.1 um of 57), the time constant 4 %.
    """
    room = either_sign(rng, float(rng.uniform(0.3, 0.7)))
    zero = either_sign(rng, 0.1e-6 * device.preset.scales.deflection)
    slower = either_sign(rng, 0.04)
    other = replace(
        device,
        ambient=device.ambient + room,
        rest=device.rest + zero,
        time_constant=device.time_constant * (1 + slower),
    )
    return other, {"ambient": room, "deflection_zero": zero, "time_constant": slower}


def names_constant(constant: str, moved: Mapping[str, Any]) -> bool:
    """Whether an entry of `moved` is about the constant of that name."""
    (found,) = (one for one in CONSTANTS if one.name == constant)
    return re.search(found.called, str(moved.get("constant", "")).lower()) is not None
