"""The device file, schema `vo2-device/1`: read, and checked key by key."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from vo2_models.io import read_yaml
from vo2_models.units import CHANNEL_QUANTITIES, SI, UNITS

__all__ = ["NEUTRAL_STEPS", "SCHEMA", "Document", "check_document", "read_device_file"]

SCHEMA = "vo2-device/1"
NEUTRAL_STEPS = 12.0
"""Sample periods over the time constant of a device without body: it settles within a sample to exp(-12) = 6e-6."""

Document = dict[str, Any]
Check = Callable[[Any, str], Any]


def read_device_file(path: Path) -> Document:
    """Return the content of a device file, as it stands there.

    Parameters
    ----------
    path : of the YAML file

    Raises
    ------
    ValueError : the file cannot be read, or holds no mapping.
    """
    document = read_yaml(path)
    if not isinstance(document, dict):
        raise ValueError(f"{path}: found {type(document).__name__}, need keys and values: {', '.join(_KEYS)}")
    return document


def check_document(document: Any, where: str) -> Document:
    """Return a device file's content with all numbers as floats and all ranges as pairs.

    Parameters
    ----------
    document : what the YAML file holds
    where : its name, for the messages

    Raises
    ------
    ValueError : an unknown or missing key, or a value that does not fit: file, key, found, needed.
    """
    found = _mapping(_KEYS, required=("schema", "id", "drive", "responses"))(document, where)
    drive, responses = found["drive"], found["responses"]
    low, high = drive["limits"]
    for key in ("operating", "safe"):
        values = drive.get(key, ())
        for value in values if isinstance(values, tuple) else (values,):
            if not low <= value <= high:
                raise ValueError(
                    f"{where}: drive: {key}: found {value:g}, need {low:g} to {high:g} {drive['unit']} (the limits)"
                )
    if "operating" in drive and drive["operating"][0] == drive["operating"][1]:
        raise ValueError(f"{where}: drive: operating: found two equal ends, need a range")
    period, shortest = (found.get("sampling", {}).get(key) for key in ("period", "shortest"))
    if period is not None and shortest is not None and shortest > period:
        raise ValueError(
            f"{where}: sampling: shortest: found {shortest:g}, need at most the period, {period:g} s"
        )
    body = found.get("body", {})
    if body.get("kind") == "none" and len(body) > 1:
        extra = ", ".join(key for key in body if key != "kind")
        raise ValueError(f"{where}: body: found {extra} with kind none, need kind first_order for them")
    if not responses:
        raise ValueError(f"{where}: responses: found none, need at least one")
    _units(found, where)
    _own_heat(found, where)
    for channel, one in responses.items():
        one.setdefault("scale", "log10" if one["unit"] == "ohm" else "linear")
        if one["scale"] == "log10" and one.get("range", (1.0,))[0] <= 0.0:
            raise ValueError(
                f"{where}: responses: {channel}: range: found {one['range'][0]:g}, need above 0 for scale log10"
            )
    for scale in ("log10", "linear"):
        alike = [channel for channel, one in responses.items() if one["scale"] == scale]
        if len(alike) > 1:
            raise ValueError(
                f"{where}: responses: found {' and '.join(alike)} with scale {scale}, need one response of each "
                "scale at most: log10 for a resistance, also one that changes little (the default in ohm), linear for what moves"
            )
    for key, channel in found.get("sensing", {}).items():
        if channel not in responses:
            raise ValueError(
                f"{where}: sensing: {key}: found {channel!r}, need a response: {', '.join(responses)}"
            )
    return found


def _own_heat(found: Document, where: str) -> None:
    """Refuse a film that is its own heater on a device whose film or drive could not be."""
    body, unit = found.get("body", {}), found["drive"]["unit"]
    if "power_gain" not in body:
        return
    place = f"{where}: body: power_gain"
    others = [key for key in ("linear_gain", "square_gain") if body.get(key)]
    if others:
        raise ValueError(
            f"{place}: found {' and '.join(others)} beside it, need one of them: what heats the body"
        )
    if unit not in ("A", "V"):
        raise ValueError(f"{place}: found a drive in {unit!r}, need A or V: the power is I^2 R or V^2/R")
    if not any(one["unit"] == "ohm" for one in found["responses"].values()):
        raise ValueError(f"{place}: found no response in ohm, need the resistance that the drive heats")


def _units(found: Document, where: str) -> None:
    """Refuse a unit that a recording does not have, or that is not the channel's."""
    channels = {found["drive"]["channel"]: (found["drive"]["unit"], f"{where}: drive: unit")}
    for channel, one in found["responses"].items():
        if channel in channels:
            raise ValueError(f"{where}: responses: {channel}: is the drive, need a channel of its own")
        channels[channel] = (one["unit"], f"{where}: responses: {channel}: unit")
    if "temperature" in found and found["temperature"]["channel"] in channels:
        raise ValueError(f"{where}: temperature: channel: found one that is drive or response already")
    for channel, (unit, place) in channels.items():
        quantity = CHANNEL_QUANTITIES.get(channel)
        if quantity is not None and unit != SI[quantity]:
            raise ValueError(f"{place}: found {unit!r}, need {SI[quantity]}, the unit of {channel}")
        if unit not in SI.values():
            known = UNITS.get(unit)
            need = SI[known.quantity] if known else ", ".join(SI.values())
            raise ValueError(f"{place}: found {unit!r}, need {need}: recordings are in SI units")


def _mapping(keys: Mapping[str, Check], *, required: tuple[str, ...] = ()) -> Check:
    def check(value: Any, where: str) -> Document:
        if not isinstance(value, dict):
            raise ValueError(f"{where}: found {value!r}, need keys and values: {', '.join(keys)}")
        for key in value:
            if key not in keys:
                raise ValueError(f"{where}: found the key {key!r}, need one of {', '.join(keys)}")
        for key in required:
            if key not in value:
                raise ValueError(f"{where}: found no {key}, need it")
        return {key: keys[key](one, f"{where}: {key}") for key, one in value.items()}

    return check


def _each(check: Check) -> Check:
    """Check of a mapping whose keys are names of the file's own."""

    def every(value: Any, where: str) -> Document:
        if not isinstance(value, dict):
            raise ValueError(f"{where}: found {value!r}, need names and what stands for them")
        return {_text(key, where): check(one, f"{where}: {key}") for key, one in value.items()}

    return every


def _text(value: Any, where: str) -> str:
    if not isinstance(value, str | int) or isinstance(value, bool) or not str(value).strip():
        raise ValueError(f"{where}: found {value!r}, need a name")
    return str(value)


def _word(value: Any, where: str) -> str:
    word = _text(value, where)
    if word.split() != [word]:
        raise ValueError(f"{where}: found {word!r}, need a name without blanks")
    return word


def _one_of(*allowed: str) -> Check:
    def check(value: Any, where: str) -> str:
        if value not in allowed:
            raise ValueError(f"{where}: found {value!r}, need {' or '.join(allowed)}")
        return str(value)

    return check


def _number(low: float = -math.inf, *, above: bool = False) -> Check:
    """Check of a finite number of at least `low`, or above it."""

    def check(value: Any, where: str) -> float:
        try:  # YAML 1.1 takes 1e-6, without a point, for a text
            number = float(value) if not isinstance(value, bool) else math.nan
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number) or number < low or (above and number == low):
            need = "a finite number" + (
                f" {'above' if above else 'of at least'} {low:g}" if low > -math.inf else ""
            )
            raise ValueError(f"{where}: found {value!r}, need {need}")
        return number

    return check


def _pair(check: Check, second: Check | None = None, *, rising: bool = False) -> Check:
    """Check of two numbers, of which `second` checks the other one where it is given."""

    def both(value: Any, where: str) -> tuple[float, float]:
        if not isinstance(value, list | tuple) or len(value) != 2:
            raise ValueError(f"{where}: found {value!r}, need two numbers, [low, high]")
        low, high = check(value[0], where), (second or check)(value[1], where)
        if rising and not low < high:
            raise ValueError(f"{where}: found {low:g} to {high:g}, need the lower end first")
        return low, high

    return both


_ANY, _POSITIVE, _NOT_NEGATIVE = _number(), _number(0.0, above=True), _number(0.0)
_RANGE, _STATISTICS = _pair(_ANY, rising=True), _pair(_ANY, _NOT_NEGATIVE)
_KEYS: dict[str, Check] = {
    "schema": _one_of(SCHEMA),
    "id": _word,
    "drive": _mapping(
        {
            "channel": _text,
            "unit": _text,
            "limits": _RANGE,
            "operating": _pair(_ANY),
            "safe": _ANY,
        },
        required=("channel", "unit", "limits"),
    ),
    "body": _mapping(
        {
            "kind": _one_of("first_order", "none"),
            "ambient": _ANY,
            "linear_gain": _ANY,
            "square_gain": _NOT_NEGATIVE,
            "power_gain": _POSITIVE,
            "time_constant": _POSITIVE,
            "dead_time": _NOT_NEGATIVE,
        },
        required=("kind",),
    ),
    "responses": _each(
        _mapping(
            {"unit": _text, "scale": _one_of("log10", "linear"), "range": _RANGE, "noise": _NOT_NEGATIVE},
            required=("unit",),
        )
    ),
    "temperature": _mapping({"channel": _text, "noise": _NOT_NEGATIVE}, required=("channel",)),
    "sensing": _mapping({"from": _text, "to": _text}, required=("from", "to")),
    "transition": _mapping({"heating": _STATISTICS, "width": _pair(_NOT_NEGATIVE), "offset": _STATISTICS}),
    "film": _mapping(
        {"activation": _POSITIVE, "metal_slope": _NOT_NEGATIVE, "threshold": _POSITIVE},
        required=("activation", "metal_slope", "threshold"),
    ),
    "structure": _mapping({"length": _POSITIVE, "expansion": _pair(_ANY)}, required=("length",)),
    "sampling": _mapping({"period": _POSITIVE, "shortest": _POSITIVE}),
    "magnitudes": _each(_each(_RANGE)),
}
"""Key of a device file -> check of what stands under it."""
