"""What a device is: its drive, body, responses, structure and sensors, as a file or a shipped preset tells it.

The chain inside has four roles: what drives the device, a film response (judged in log10), a tip response (judged as it
is), and the temperature of the heated body. The names of the roles are the channels of the contract. A device file
names its own channels and units; a recording is translated to roles where it is read and back where it is written.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from vo2_models.device.description_file import (
    NEUTRAL_STEPS,
    Document,
    check_document,
    read_device_file,
)
from vo2_models.io import InputError
from vo2_models.parameters import Parameter, Value
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

__all__ = [
    "PRESETS",
    "DeviceDescription",
    "DeviceParameter",
    "Response",
    "Sites",
    "check_model_of",
    "described",
    "preset",
]

_FILES = Path(__file__).resolve().parent / "files"
PRESETS = tuple(sorted(path.stem for path in _FILES.glob("*.yaml")))
"""Ids of the devices that are shipped."""

_LOOP = (30.0, 90.0)
"""Loop coordinate [degC] at the two ends of the operating range of a device whose file tells no temperature. A fit's
bounds and starts are made for loops of some tens of kelvin; on such a device they are shares of the drive's span."""
_KELVINS = (10.0, 300.0)
"""Span of a driving temperature [K] that is taken as it is."""


_POSSIBLE = (-273.15, 4000.0)
"""Temperatures of a body [degC]: from absolute zero to where no solid is left."""
_REACHED = 3.0
"""Standard deviations by which a transition's middle may lie outside the operating range; next to nothing is inside then."""


@dataclass(frozen=True)
class DeviceParameter(Parameter):
    """A text that names a device, as `preset` takes it; empty only where that is the default."""

    def check(self, value: Value) -> Value:
        """Return `value` if it names a device; raise a `ValueError` naming parameter, finding and need."""
        if value != self.default:
            try:
                preset(str(value))
            except ValueError as error:
                raise ValueError(f"{self.name}: {error}") from error
        return value


@dataclass(frozen=True)
class Response:
    """One measured response: `channel` and `unit` as in recordings of the device, `role` the contract's channel that it is."""

    channel: str
    unit: str
    role: str


@dataclass(frozen=True)
class Sites:
    """Material of a device that can be simulated from its switching domains.

    Attributes
    ----------
    activation : activation energy of the insulating phase over Boltzmann's constant [K]
    metal_slope : decades of resistance the metallic phase loses per kelvin [1/K]
    threshold : percolation threshold of the metallic phase
    expansion : curvature lost per kelvin in the insulating and the metallic phase [1/(m K)], k_0 and k_1 of (5.7)
    """

    activation: float
    metal_slope: float
    threshold: float
    expansion: tuple[float, float]


@dataclass(frozen=True)
class DeviceDescription:
    """Description of a device; nothing in it is fitted.

    What a file leaves open has a value too, derived from the rest; `tells` says which is which.

    Attributes
    ----------
    id : name in `header.frame_id`
    drive_channel, drive_unit : of the drive; the unit is A on both presets and wherever [A] stands below
    current_range, operating_range : [A]; the operating range runs from its coldest to its hottest drive
    safe : drive a loop goes to when it loses its input [A]
    has_body : whether a heated body stands between drive and responses
    ambient : [degC]; without body the origin of the loop coordinate
    linear_gain, square_gain : steady temperature rise per drive [K/A] and per squared drive [K/A^2]
    power_gain : steady temperature rise per electrical power in the film itself [K/W], 0 where it is not its own heater;
        `square_gain` is then that of the geometric middle of its resistance
    time_constant, dead_time : of the heated body [s]
    responses : measured responses, film and tip role at most once each
    temperature_channel : measured temperature of the body, empty without
    sensing : (from, to) channels of self-sensing, empty names without
    resistance_range : lowest and highest over the operating range [ohm]
    deflection_extent : lowest and highest tip response over the operating range [m]
    deflection_range : what "per cent of range" divides by [m]
    heating, width, offset : mean and standard deviation over the material of the metallic transition on heating
        [degC, K], the loop width [K], the structural minus the metallic transition [K]
    noise : role -> one standard deviation: relative for the film response, else in the channel's unit
    sample_period, shortest_period : [s]
    sites : of a device that can be simulated from its domains, None for others
    length : of the cantilever [m], NaN without structure
    magnitudes : effect -> parameter -> (low, high): clearly visible magnitudes, for demonstrations
    document : the file's content, as one line of JSON
    """

    id: str
    drive_channel: str
    drive_unit: str
    current_range: tuple[float, float]
    operating_range: tuple[float, float]
    safe: float
    has_body: bool
    ambient: float
    linear_gain: float
    square_gain: float
    power_gain: float
    time_constant: float
    dead_time: float
    responses: tuple[Response, ...]
    temperature_channel: str
    sensing: tuple[str, str]
    resistance_range: tuple[float, float]
    deflection_extent: tuple[float, float]
    deflection_range: float
    heating: tuple[float, float]
    width: tuple[float, float]
    offset: tuple[float, float]
    noise: dict[str, float] = field(hash=False)
    sample_period: float
    shortest_period: float
    sites: Sites | None
    length: float
    magnitudes: Mapping[str, Mapping[str, tuple[float, float]]] = field(hash=False)
    document: str

    @property
    def channels(self) -> tuple[str, ...]:
        """Roles of the measured channels."""
        own = tuple(r.role for r in self.responses)
        measured = tuple(role for role in (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION) if role in own)
        return (HEATER_CURRENT, *measured, *((STAGE_TEMPERATURE,) if self.measures_temperature else ()))

    @property
    def measures_temperature(self) -> bool:
        """Whether the temperature of the body is measured."""
        return bool(self.temperature_channel)

    @property
    def has_resistance(self) -> bool:
        """Whether there is a film response that is a resistance."""
        return any(r.role == RESISTANCE and r.unit == "ohm" for r in self.responses)

    @property
    def is_one_loop(self) -> bool:
        """Whether a loop is all between the drive and a single response: no body, and no structure that the file tells."""
        return not self.has_body and len(self.responses) == 1 and not self.tells("structure")

    @property
    def key(self) -> str:
        """What stands for this device in a model: its id if it is a shipped one, else its whole description."""
        return self.id if self.id in PRESETS and preset(self.id) == self else self.document

    @property
    def names(self) -> dict[str, str]:
        """Role -> channel of this device's recordings."""
        found = {HEATER_CURRENT: self.drive_channel} | {r.role: r.channel for r in self.responses}
        return found | ({STAGE_TEMPERATURE: self.temperature_channel} if self.temperature_channel else {})

    @property
    def units(self) -> dict[str, str]:
        """Role -> unit of its channel."""
        found = {HEATER_CURRENT: self.drive_unit} | {r.role: r.unit for r in self.responses}
        return found | ({STAGE_TEMPERATURE: "degC"} if self.temperature_channel else {})

    def in_own_names(self, text: str) -> str:
        """Return a text in which each channel has the name that this device's file gives it, in place of its role."""
        names = self.names
        return re.sub(rf"\b({'|'.join(names)})\b", lambda role: names[role[0]], text)

    def own_unit(self, unit: str, signal: str = "") -> str:
        """Return a unit of an effect's parameter, which is written for amperes and metres, in the units of this device.

        Parameters
        ----------
        unit : such as A/s, 1/m^2 or "channel unit/s"
        signal : role of the channel that "channel unit" stands for

        Examples
        --------
        >>> preset("integrated").own_unit("channel unit/s", "tip_deflection")
        'm/s'
        """
        own = self.units
        parts = {
            "A": own[HEATER_CURRENT],
            "m": own.get(TIP_DEFLECTION, "m"),
            "channel unit": own.get(signal, "1"),
        }

        def put(found: re.Match[str]) -> str:
            part = parts[found[0]]
            return part if part.isalnum() or found[0] == unit else f"({part})"

        return re.sub(r"channel unit|\bA\b|\bm\b", put, unit)

    def tells(self, *keys: str) -> bool:
        """Whether the file has a value at this place, such as `body, time_constant`."""
        at: Any = json.loads(self.document)
        for key in keys:
            if not isinstance(at, dict) or key not in at:
                return False
            at = at[key]
        return True

    def completed(self, changes: Document) -> DeviceDescription:
        """Return the description with values filled in, nested as in the file; what the file tells stays."""
        return described(_filled(json.loads(self.document), changes), "device")

    def running(self, operating: tuple[float, float]) -> DeviceDescription:
        """Return the description with another operating range, or the other end of it as the lower saturation."""
        document = json.loads(self.document)
        document["drive"]["operating"] = list(operating)
        return described(document, "device")

    def in_roles(self, recording: Recording) -> Recording:
        """Return a recording of this device with its channels under the names of their roles.

        Channels that the device does not have keep their names, unless that is the name of a role: they are left out.
        """
        roles = {channel: role for role, channel in self.names.items()}
        roles[f"commanded_{self.drive_channel}"] = COMMANDED_CURRENT
        taken = {HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE, COMMANDED_CURRENT}
        channels = {
            roles.get(name, name): values
            for name, values in recording.channels.items()
            if name in roles or name not in taken
        }
        return replace(recording, channels=channels)

    def understood(self, recording: Recording) -> Recording:
        """Return a recording in roles, whether its channels are called as this device's or by their roles already."""
        own = set(self.names.values()) - set(self.names)
        return self.in_roles(recording) if any(name in recording for name in own) else recording

    def in_channels(self, recording: Recording) -> Recording:
        """Return a recording in roles with the names of this device's channels: the inverse of `in_roles`."""
        names = {**self.names, COMMANDED_CURRENT: f"commanded_{self.drive_channel}"}
        channels = {names.get(name, name): values for name, values in recording.channels.items()}
        return replace(recording, channels=channels, device=self.id)

    def steady_temperature(self, current: float) -> float:
        """Temperature [degC] the nominal thermal model settles to at the drive [A]."""
        return self.ambient + self.linear_gain * current + self.square_gain * current * current


def preset(name: str | Path) -> DeviceDescription:
    """Return the description of a device.

    Parameters
    ----------
    name : id of a shipped one, path of a device file, or the text that a model holds of it

    Raises
    ------
    ValueError : none of these; or a file that is none, with the key, what was found and what is needed.
    """
    text = str(name)
    if text in PRESETS:
        return _shipped(text)
    if text.startswith("{"):
        return _of_text(text)
    path = Path(text)
    if path.suffix not in (".yaml", ".yml") and not path.is_file():
        raise ValueError(
            f"device: found {text!r}, need one of {', '.join(PRESETS)}, or the path of a device file"
        )
    try:
        device = described(read_device_file(path), str(path))
        _check_temperatures(device, str(path))
        return device
    except ValueError as error:
        raise InputError(str(error)) from error  # in one line, whatever the file holds


def _check_temperatures(device: DeviceDescription, where: str) -> None:
    """Refuse numbers with which the body gets to temperatures that none can have, or not to its transition."""
    if device.power_gain:
        return  # its heat goes with a resistance that the file need not tell
    cold, hot = sorted(device.steady_temperature(drive) for drive in device.operating_range)
    lowest, highest = _POSSIBLE
    if not lowest <= cold <= hot <= highest:
        raise ValueError(
            f"{where}: body: found {cold:.4g} to {hot:.4g} degC over the operating range, need {lowest:g} to {highest:g} degC: "
            f"ambient in degC, drive in {device.drive_unit}, gains in K/{device.drive_unit} and K/{device.drive_unit}^2"
        )
    middle, deviation = device.heating
    beyond = _REACHED * deviation
    if device.tells("transition", "heating") and not cold - beyond <= middle <= hot + beyond:
        raise ValueError(
            f"{where}: transition: heating: found {middle:g}, need what the body gets to over the operating range, {cold:.4g} to "
            f"{hot:.4g} degC: ambient ({device.ambient:g}) and heating in degC, gains that fit them"
        )


def check_model_of(device: str, name: str) -> None:
    """Raise a `ValueError` where a model is of another device than a node's, in one line.

    Devices are told by their ids: a fit completes the description that its model holds, which is then no more the file's.

    Parameters
    ----------
    device : `model.device` of the model
    name : id of a shipped device or path of a device file, as the node has it
    """
    found, wanted = preset(device).id, preset(name).id
    if found != wanted:
        raise ValueError(
            f"model.device: found {found}, need the preset {wanted}; set the preset or load its model"
        )


@lru_cache(maxsize=16)
def _shipped(name: str) -> DeviceDescription:
    return described(read_device_file(_FILES / f"{name}.yaml"), name)


@lru_cache(maxsize=16)
def _of_text(text: str) -> DeviceDescription:
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(
            f"device: found a text that is no description ({error}); need a device file"
        ) from None
    return described(document, "device")


def described(document: Any, where: str) -> DeviceDescription:
    """Return the description of a device.

    Parameters
    ----------
    document : content of its file
    where : what stands in front of what is wrong with it

    Raises
    ------
    ValueError : an unknown key, a missing one, or a value that does not fit.
    """
    checked = check_document(document, where)
    drive, sampling = checked["drive"], checked.get("sampling", {})
    limits = drive["limits"]
    operating = drive.get("operating", limits)
    period = sampling.get("period", 1.0)
    responses = tuple(
        Response(channel, one["unit"], RESISTANCE if one["scale"] == "log10" else TIP_DEFLECTION)
        for channel, one in checked["responses"].items()
    )
    entries = {r.role: checked["responses"][r.channel] for r in responses}
    film_range = entries.get(RESISTANCE, {}).get("range", (1.0, 10.0))
    body = _body(checked.get("body", {}), drive["unit"], operating, period, film_range)
    noise = {role: one["noise"] for role, one in entries.items() if "noise" in one}
    temperature = checked.get("temperature", {})
    if "noise" in temperature:
        noise[STAGE_TEMPERATURE] = temperature["noise"]
    extent = entries.get(TIP_DEFLECTION, {}).get("range", (0.0, 1.0))
    structure, film, sensing = (checked.get(part, {}) for part in ("structure", "film", "sensing"))
    sites = None
    if film and "expansion" in structure:
        sites = Sites(film["activation"], film["metal_slope"], film["threshold"], structure["expansion"])
    ends = sorted(body["ambient"] + body["linear_gain"] * i + body["square_gain"] * i * i for i in operating)
    span = ends[1] - ends[0]
    # where nothing is told of the material, its transitions are anywhere in the operating range
    transition = {
        "heating": (ends[0] + 0.55 * span, 0.2 * span),
        "width": (0.1 * span, 0.05 * span),
        "offset": (0.0, 0.02 * span),
        **checked.get("transition", {}),
    }
    return DeviceDescription(
        id=checked["id"],
        drive_channel=drive["channel"],
        drive_unit=drive["unit"],
        current_range=limits,
        operating_range=operating,
        safe=drive.get("safe", min(max(0.0, limits[0]), limits[1])),
        responses=responses,
        temperature_channel=temperature.get("channel", ""),
        sensing=(sensing.get("from", ""), sensing.get("to", "")),
        resistance_range=film_range,
        deflection_extent=extent,
        deflection_range=extent[1] - extent[0],
        noise=noise,
        sample_period=period,
        shortest_period=sampling.get("shortest", period / NEUTRAL_STEPS),
        sites=sites,
        length=structure.get("length", float("nan")),
        magnitudes=checked.get("magnitudes", {}),
        document=json.dumps(document, separators=(",", ":"), sort_keys=True),
        **body,
        **transition,
    )


def _body(
    entry: Document,
    unit: str,
    operating: tuple[float, float],
    period: float,
    film_range: tuple[float, float],
) -> dict[str, Any]:
    """Thermal numbers of a device; a temperature that drives stays what it is, any other drive is laid over `_LOOP`."""
    has_body = entry.get("kind") == "first_order"
    heat = {name: entry[name] for name in ("ambient", "linear_gain", "square_gain") if name in entry}
    power_gain = entry.get("power_gain", 0.0)
    if power_gain:
        middle = math.sqrt(film_range[0] * film_range[1])
        heat["square_gain"] = power_gain * (middle if unit == "A" else 1.0 / middle)
    if not heat.get("linear_gain") and not heat.get("square_gain"):
        span = operating[1] - operating[0]
        if unit == "degC" and _KELVINS[0] <= span <= _KELVINS[1]:
            heat = {"ambient": 0.0, "linear_gain": 1.0, "square_gain": 0.0}
        else:
            gain = (_LOOP[1] - _LOOP[0]) / span
            heat = {"ambient": _LOOP[0] - gain * operating[0], "linear_gain": gain, "square_gain": 0.0}
    return {
        "has_body": has_body,
        "ambient": heat.get("ambient", 22.0),
        "linear_gain": heat.get("linear_gain", 0.0),
        "square_gain": heat.get("square_gain", 0.0),
        "power_gain": power_gain,
        "time_constant": entry.get("time_constant", 10.0 * period if has_body else period / NEUTRAL_STEPS),
        "dead_time": entry.get("dead_time", 0.0),
    }


def _filled(document: Document, changes: Document) -> Document:
    """The document with those of the changes that it does not have."""
    found = {**changes, **document}
    for key, value in changes.items():
        if isinstance(value, dict) and isinstance(document.get(key), dict):
            found[key] = _filled(document[key], value)
    return found
