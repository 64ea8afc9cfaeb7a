"""Units a rig may write its numbers in, the quantities they measure, and the unit that a recording has of each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches

from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = [
    "CHANNEL_QUANTITIES",
    "SI",
    "UNITS",
    "Unit",
    "any_unit",
    "fitting_units",
    "shown_unit",
    "stamp_in_words",
    "unit_named",
]


@dataclass(frozen=True)
class Unit:
    """SI value (degree Celsius for temperatures) = factor * number + offset."""

    quantity: str
    factor: float
    offset: float = 0.0


_OF_DAY_S = 1e6
"""Stamps beyond are times of day [s]."""
_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12}
_MICRO = ("\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}")
_BASES = {
    "m": "length",
    "s": "time",
    "A": "current",
    "V": "voltage",
    "ohm": "resistance",
    "S": "conductance",
    "W": "power",
    "J": "energy",
    "C": "charge",
    "F": "capacitance",
    "C/m2": "polarisation",
    "V/m": "electric field",
    "N": "force",
    "N m": "torque",
    "Pa": "pressure",
    "Wb": "magnetic flux",
    "H": "inductance",
    "T": "flux density",
    "A/m": "magnetic field",
    "A m2": "magnetic moment",
    "rad": "angle",
    "Hz": "frequency",
    "m/s": "velocity",
}
_OTHER_NAMES = {
    "ohm": ("Ohm", "\N{GREEK CAPITAL LETTER OMEGA}", "\N{OHM SIGN}"),
    "N m": ("Nm", "N*m"),
    "degC": ("°C",),
    "degF": ("°F",),
}
_WITHOUT_PREFIX = {
    "min": Unit("time", 60.0),
    "h": Unit("time", 3600.0),
    "degC": Unit("temperature", 1.0),
    "K": Unit("temperature", 1.0, -273.15),
    "degF": Unit("temperature", 5 / 9, -160 / 9),
    "bar": Unit("pressure", 1e5),
    "Oe": Unit("magnetic field", 1e3 / (4.0 * math.pi)),
    "G": Unit("flux density", 1e-4),
    "emu": Unit("magnetic moment", 1e-3),
    "deg": Unit("angle", math.pi / 180.0),
    "%": Unit("number", 0.01),
    "1": Unit("number", 1.0),
}

UNITS = {
    prefix + base: Unit(kind, factor) for base, kind in _BASES.items() for prefix, factor in _PREFIXES.items()
} | _WITHOUT_PREFIX
"""Name in a map -> unit; `unit_named` knows further spellings."""

SI = {
    **{kind: base for base, kind in _BASES.items()},
    "temperature": "degC",
    "number": "1",
}
"""Quantity -> unit of a recording."""


CHANNEL_QUANTITIES = {
    HEATER_CURRENT: "current",
    RESISTANCE: "resistance",
    TIP_DEFLECTION: "length",
    STAGE_TEMPERATURE: "temperature",
    "heater_voltage": "voltage",
    "sense_current": "current",
    "ambient_temperature": "temperature",
    "laser_on": "number",
}
"""Channels of the contract, and what they measure; a device file may name others."""


def any_unit(name: str) -> Unit | None:
    """Return the unit of this name, whatever it measures; None if there is none."""
    return UNITS.get(_plain(name))


def unit_named(name: str, quantity: str) -> Unit | None:
    """Return the unit of a quantity, None if there is none of this name."""
    unit = any_unit(name)
    return unit if unit is not None and unit.quantity == quantity else None


def shown_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which a text or a figure gives what a recording has in `unit`, and the factor to it.

    Parameters
    ----------
    unit : of a recording

    Examples
    --------
    >>> shown_unit("m"), shown_unit("N")
    (('um', 1000000.0), ('N', 1.0))
    """
    return ("um", 1e6) if unit == "m" else (unit, 1.0)


def fitting_units(name: str, quantity: str = "") -> str:
    """Say which units there are, and what a misspelt name may have meant.

    Parameters
    ----------
    quantity : physical quantity, such as length; empty for any

    Returns
    -------
    the end of an error message
    """
    there = [one for one, unit in UNITS.items() if quantity in ("", unit.quantity)]
    lower = {one.lower(): one for one in there}
    meant = get_close_matches(_plain(name).lower(), lower, n=1, cutoff=0.6)
    guess = f" (did you mean {lower[meant[0]]}?)" if meant else ""
    if quantity:
        return ", ".join(there) + guess
    prefixes = ", ".join(prefix for prefix in _PREFIXES if prefix)
    return f"{', '.join(_BASES)} (each also with {prefixes} before it), {', '.join(_WITHOUT_PREFIX)}{guess}"


def _plain(name: str) -> str:
    for letter in _MICRO:
        name = name.replace(letter, "u")
    for plain, others in _OTHER_NAMES.items():
        for other in others:
            if name.endswith(other):
                return name.removesuffix(other) + plain
    return name


def stamp_in_words(stamp_s: float, *, digits: int = 6) -> str:
    """Return a stamp with its unit; of a time of day the milliseconds too, which are behind the tenth digit.

    Parameters
    ----------
    stamp_s : [s]
    digits : of a stamp that is no time of day
    """
    return f"{stamp_s:.3f} s" if abs(stamp_s) > _OF_DAY_S else f"{stamp_s:.{digits}g} s"
