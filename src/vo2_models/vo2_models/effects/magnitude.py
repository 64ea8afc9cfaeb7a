"""What an effect needs of a device, and how large it has to be there to be seen.

Demonstration magnitudes are written for the two shipped devices, or in a device's own file. For any other device they
are scaled by its natural units: seconds by its time constant, kelvins by the span of its temperature, amperes by the
span of its drive, and so on; a unit such as K/A^2 is taken apart.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

if TYPE_CHECKING:
    from vo2_models.device.description import DeviceDescription
    from vo2_models.effects.record import Effect

__all__ = ["NEEDS", "lacks", "magnitudes", "natural_scale", "unit_parts"]

Ranges = Mapping[str, tuple[float, float]]

NEEDS = {
    "body": "a heated body",
    "heater": "a body that is heated by the square of its drive",
    "pump": "a stage that is heated in proportion to its drive, with a temperature of its own",
    "one body": "a film that is one with its heated body",
    "resistance": "a resistance",
}
"""What an effect can need of a device, in words."""


def _has(device: DeviceDescription) -> set[str]:
    found = set()
    if device.has_body:
        found.add("body")
        if device.square_gain and not device.power_gain:
            found.add("heater")
        if device.linear_gain and device.measures_temperature:
            found.add("pump")
        if not device.measures_temperature:
            found.add("one body")
    if device.has_resistance:
        found.add("resistance")
    return found


def lacks(effect: Effect, device: DeviceDescription) -> str:
    """Return in words what a device lacks for an effect, empty where the effect can occur on it."""
    missing = [NEEDS[need] for need in effect.needs if need not in _has(device)]
    if not missing and not any(channel in device.channels for channel in effect.channels):
        missing = ["a channel that it reaches"]
    return ", ".join(missing)


_BASES = ("1", "rad", "choice", "s", "K", "A", "ohm", "m", "degC", "Hz", "S", "channel unit")
"""What a unit is made of; `natural_scale` knows the size of each on any device."""


def unit_parts(unit: str) -> list[tuple[str, int]]:
    """Return (base unit, power) of each part of a unit text.

    Parameters
    ----------
    unit : products and quotients, such as K/A^2 or A^2 ohm/K

    Raises
    ------
    ValueError : a part that no device has a size of.
    """
    found = []
    for sign, side in zip((1, *[-1] * unit.count("/")), unit.split("/"), strict=True):
        for part in re.findall(r"channel unit|\S+", side) or [side]:
            match = re.fullmatch(r"([^^]+)(?:\^(\d+))?", part)
            if match is None or match[1] not in _BASES:
                raise ValueError(f"unit: found {unit!r}, need parts of {', '.join(_BASES)}")
            found.append((match[1], sign * int(match[2] or 1)))
    return found


def natural_scale(unit: str, device: DeviceDescription, signal: str = "") -> float:
    """Return the size of a unit on a device: the product of the sizes of its parts.

    Parameters
    ----------
    unit : SI unit text such as K/A^2; "channel unit" in it is the span of the signal
    device : whose sizes are taken
    signal : channel that "channel unit" stands for

    Raises
    ------
    ValueError : a part that is none of s, Hz, K, degC, A, ohm, S, m, 1.
    """
    low, high = device.resistance_range
    drive = abs(device.operating_range[1] - device.operating_range[0])
    warmest, coldest = (device.steady_temperature(i) for i in device.operating_range)
    size = {
        "1": 1.0,
        "rad": 1.0,
        "choice": 1.0,
        "s": device.time_constant if device.has_body else 10.0 * device.sample_period,
        "K": abs(warmest - coldest),
        "A": drive,
        "ohm": float(np.sqrt(low * high)),
        "m": device.deflection_range,
    }
    size |= {"degC": size["K"], "Hz": 1.0 / size["s"], "S": 1.0 / size["ohm"]}
    spans = {
        HEATER_CURRENT: drive,
        RESISTANCE: high - low,
        TIP_DEFLECTION: size["m"],
        STAGE_TEMPERATURE: size["K"],
    }
    size["channel unit"] = spans.get(signal, np.nan)
    return math.prod(size[base] ** power for base, power in unit_parts(unit))


def magnitudes(effect: Effect, device: DeviceDescription, signal: str = "") -> Ranges:
    """Return parameter -> (low, high) of clearly visible magnitudes of an effect on a device.

    From the device's file, else as written for a shipped device, else scaled from one that is.

    Parameters
    ----------
    effect : of the catalogue
    device : that it is to act on
    signal : channel that it sits on, empty for none

    Returns
    -------
    dict : parameter -> (low, high) in its unit; empty where nothing is written for any device
    """
    for key in (f"{effect.id}:{signal}", effect.id):
        if key in device.magnitudes:
            return device.magnitudes[key]
    from vo2_models.device.description import preset

    written = effect.typical
    own = written.get(f"{device.key}:{signal}") or written.get(device.key)
    if own is not None:
        return own
    for name in ("integrated", "peltier"):
        known = written.get(f"{name}:{signal}") or written.get(name)
        if known is None:
            continue
        units = {p.name: p.unit for p in effect.parameters}
        factor = {
            n: natural_scale(units[n], device, signal) / natural_scale(units[n], preset(name), signal)
            for n in known
        }
        return {n: (low * factor[n], high * factor[n]) for n, (low, high) in known.items()}
    return {}
