"""`describe`: a first device file from a recording, to be read and completed by a person."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

if TYPE_CHECKING:
    from vo2_models.device.description_file import Document
    from vo2_models.recording import Recording

from vo2_models.command_line import INTERRUPTED, Progress, refuse

__all__ = ["drafted", "main"]

_DESCRIPTION = """
Draft a device file from a bag: channels, units where their names tell them, ranges, noise, sampling, and the lag of the
responses behind the drive. What it could not know is marked; read it before you use it.
"""
_WORDS = {
    "resistance": ("resistance", "ohm"),
    "voltage": ("volt",),
    "current": ("current", "ampere"),
    "length": ("deflection", "displacement", "position", "extension", "distance"),
    "temperature": ("temperature", "degc"),
    "force": ("force", "newton"),
    "pressure": ("pressure",),
    "magnetic moment": ("moment",),
    "flux density": ("flux_density", "tesla"),
    "charge": ("charge", "coulomb"),
    "capacitance": ("capacitance", "farad"),
    "inductance": ("inductance", "henry"),
    "torque": ("torque",),
    "power": ("power", "watt"),
}
"""Quantity -> what in a channel's name tells it."""
_ROOM, _RISE = 22.0, 75.0
"""Temperature [degC] without drive and its rise [K] at the largest: without a thermometer they are no more than a scale."""
_UNKNOWN = "?"
_EVERY_S = 10.0
"""Least time between two lines of progress where there is no terminal [s]."""


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C.

    Parameters
    ----------
    args : arguments of the command line; those of the process by default
    """
    parser = argparse.ArgumentParser(prog="describe", description=_DESCRIPTION, allow_abbrev=False)
    parser.add_argument("--bag", type=Path, required=True, help="bag of the device")
    parser.add_argument("--drive", help="channel that drives the device (default: what the names suggest)")
    parser.add_argument("--output", type=Path, help="device file to write (default: on the terminal)")
    parser.add_argument("--quiet", action="store_true", help="no progress on standard error")
    options = parser.parse_args(args)
    try:
        with Progress("describe", quiet=options.quiet, every_s=_EVERY_S) as progress:
            progress(0.0, "reading")
            text = _text(options.bag, options.drive, lambda share: progress(share, "lag and delay"))
        if options.output is None:
            print(text, end="")
        elif options.output.exists():
            raise ValueError(f"{options.output}: exists already, need the name of a new file")
        else:
            options.output.write_text(text, encoding="utf-8")
            print(f"wrote {options.output}")
    except (ValueError, OSError) as error:
        return refuse("describe", error)
    except KeyboardInterrupt:
        print("describe: interrupted; nothing is written", file=sys.stderr)
        return INTERRUPTED
    return 0


def _text(bag: Path, drive: str | None, progress: Callable[[float], None]) -> str:
    from vo2_identification.bags import read_bag
    from vo2_identification.bags.problems import BagError

    recordings, _ = read_bag(bag, roles=("measurement", "command"), channels=None)
    if "measurement" not in recordings:
        raise BagError(f"{bag}: found no samples on a topic .../measurement, need them")
    commanded = list(recordings["command"].channels) if "command" in recordings else []
    document, notes = drafted(recordings["measurement"], drive or next(iter(commanded), None), progress)
    head = "".join(f"# {note}\n" for note in [f"drafted by `describe` from {bag}", *notes])
    return head + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)


def drafted(
    recording: Recording, drive: str | None, progress: Callable[[float], None] | None = None
) -> tuple[Document, list[str]]:
    """Return the content of a device file, and what a person must look at, one sentence each.

    Parameters
    ----------
    recording : under the rig's own channel names
    drive : channel that drives, None for what the names suggest
    progress : called with the share done, 0 to 1

    Raises
    ------
    ValueError : the drive is not there, or is constant, or nothing else is.
    """
    import numpy as np
    from vo2_models.device.description import described
    from vo2_models.device.description_file import SCHEMA
    from vo2_models.identification.completion import completed, significant
    from vo2_models.identification.grid import on_grid
    from vo2_models.identification.rig_dynamics import choose_dynamics
    from vo2_models.recording import HEATER_CURRENT, STAGE_TEMPERATURE
    from vo2_models.units import SI

    names = [name for name, values in recording.channels.items() if np.isfinite(values).any()]
    chosen = drive or (HEATER_CURRENT if HEATER_CURRENT in names else next(iter(names), ""))
    if chosen not in names or len(names) < 2:
        raise ValueError(
            f"drive: found {', '.join(names) or 'no channel'}, need {drive or 'a drive'} and a response"
        )
    values = recording[chosen][np.isfinite(recording[chosen])]
    low, high = significant(float(values.min())), significant(float(values.max()))
    if not low < high:
        raise ValueError(f"{chosen}: found nothing but {low:g}, need a drive that moves")
    units = {name: _unit(name) for name in names}
    notes = [
        f"drive: {chosen} was taken for the drive; its limits are what was recorded: widen them to what is allowed"
    ]
    notes += [
        f"{name}: unit not known from the name: put one of {', '.join(SI.values())}"
        for name in names
        if units[name] == _UNKNOWN
    ]
    known = [f"{name} in {units[name]}" for name in names if units[name] != _UNKNOWN]
    if known:
        notes.append(f"units were taken from the names, check them: {', '.join(known)}")
    document: Document = {
        "schema": SCHEMA,
        "id": Path(recording.device).stem or "my_rig",
        "drive": {"channel": chosen, "unit": units[chosen], "limits": [low, high], "operating": [low, high]},
        "body": {"kind": "none"},
        "responses": {},
    }
    if STAGE_TEMPERATURE in names and chosen != STAGE_TEMPERATURE:
        document["temperature"] = {"channel": STAGE_TEMPERATURE}
    for scale in ("log10", "linear"):
        fitting = [
            n
            for n in names
            if n not in (chosen, STAGE_TEMPERATURE) and (units[n] == "ohm") == (scale == "log10")
        ]
        if fitting:
            document["responses"][fitting[0]] = {"unit": units[fitting[0]], "scale": scale}
        if fitting[1:]:
            notes.append(f"{', '.join(fitting[1:])}: left out, a device has one response of scale {scale}")
    # a unit that is not known must not keep the numbers from being found: any will do for them
    device = described(_with_any_unit({**document, "temperature": None}), "draft")
    inside = device.in_roles(recording)
    device = completed(device, [inside])
    full = json.loads(device.document)
    for name, entry in document["responses"].items():
        entry |= {
            key: full["responses"][name][key] for key in ("range", "noise") if key in full["responses"][name]
        }
    document["sampling"] = {"period": full["sampling"]["period"]}
    grid = on_grid(inside)
    path_values = {
        role: np.concatenate([[np.nan], column])
        for role, column in grid.measured.items()
        if role in device.channels
    }
    dynamics = choose_dynamics([grid], device, path_values, progress=progress)
    if dynamics.falling:
        document["drive"]["operating"] = [high, low]
        notes.append(
            "operating: the loop runs backwards over the drive, so its range is given from high to low"
        )
    if dynamics.lag or dynamics.delay:
        sizes = (("lag", dynamics.lag), ("delay", dynamics.delay))
        found = " and ".join(f"a {kind} of about {size:.3g} s" for kind, size in sizes if size)
        notes.append(f"the responses are behind the drive with {found}; `fit` finds it again")
        if chosen == HEATER_CURRENT and dynamics.lag:
            body = {"kind": "first_order", "time_constant": significant(dynamics.lag, 3)}
            if low >= 0.0:
                body |= {"ambient": _ROOM, "linear_gain": 0.0, "square_gain": significant(_RISE / high**2, 3)}
                notes.append(
                    f"body: the heat was taken to go as the square of the current; {_ROOM:g} degC and {_RISE:g} K at the largest "
                    "current only set the scale. Write linear_gain where it goes as the current itself"
                )
            document["body"] = body
    return document, notes


def _with_any_unit(document: Document) -> Document:
    """The document with a number's unit for one that is not known, and without what is None."""
    return {
        key: _with_any_unit(value) if isinstance(value, dict) else "1" if value == _UNKNOWN else value
        for key, value in document.items()
        if value is not None
    }


def _unit(name: str) -> str:
    """Unit of a channel by the contract or by a word in its name; a question mark where neither tells."""
    from vo2_models.units import CHANNEL_QUANTITIES, SI

    if name in CHANNEL_QUANTITIES:
        return SI[CHANNEL_QUANTITIES[name]]
    found = [quantity for quantity, words in _WORDS.items() if any(word in name.lower() for word in words)]
    return SI[found[0]] if len(found) == 1 else _UNKNOWN


if __name__ == "__main__":
    sys.exit(main())
