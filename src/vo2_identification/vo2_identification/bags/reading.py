"""A bag as recordings: one per topic of the contract, with everything that is wrong named."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vo2_models.device.description import DeviceDescription
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
    counted,
    regular_instants,
)

from vo2_identification.bags.channels import JOINT_STATE, Channel
from vo2_identification.bags.joint_state import JointStates, Samples
from vo2_identification.bags.problems import BagError, Problem, limited
from vo2_identification.bags.stamps import find_gaps, increasing_samples
from vo2_identification.bags.storage import raw_messages

__all__ = ["KNOWN_CHANNELS", "ROLES", "commanded_current", "read_bag", "read_recording"]

ROLES = ("command", "measurement", "estimate", "reference")
"""Last parts of the topic names that carry samples."""
_HELD = 4.0
"""Sample periods for which a command that was followed by none is taken as held by the driver, and not as lost to the log."""
_SOME, _FOR_MOST = 10, 0.5
"""Commands, and commands a sample, from which whoever commands is taken to do so at every sample."""
_MOST_VALUES = 20_000_000
"""Stamps and values of one bag that are held: 2.8 million samples of four channels and their commands, some 0.6 GB."""
_LOOK_EVERY = 1 << 14
KNOWN_CHANNELS = (
    HEATER_CURRENT,
    RESISTANCE,
    TIP_DEFLECTION,
    STAGE_TEMPERATURE,
    "temperature_surrogate",
    "tip_deflection_bound",
    "heater_voltage",
    "sense_current",
    "ambient_temperature",
    "laser_on",
)
"""Channels that are read; a message may have others, which are ignored."""


def read_recording(
    path: str | Path, *, device: DeviceDescription | None = None, namespace: str = "/vo2"
) -> tuple[Recording, list[Problem]]:
    """Return the measurement of a bag, with the commanded current if it has commands, and what is wrong.

    Missing samples of a channel are NaN, infinite ones too. `commanded_current` is NaN up to the first command.

    Parameters
    ----------
    path : bag directory (with or without metadata.yaml), or a single .mcap or .db3 file
    device : whose channels are read and returned under the names of their roles, which they may have already, as in what the
        graph records; None for those of the contract
    namespace : where the topics are looked for first; else any namespace is taken, and reported

    Raises
    ------
    BagError : no bag, or no measurement in it.
    """
    wanted = KNOWN_CHANNELS if device is None else (*KNOWN_CHANNELS, *device.names.values())
    recordings, problems = read_bag(
        path, namespace=namespace, roles=("measurement", "command"), channels=wanted
    )
    if "measurement" not in recordings:
        others = [str(problem) for problem in problems if problem.kind != "missing_topic"][:3]
        raise BagError(
            f"{path}: found no samples on a topic {namespace}/measurement (or .../measurement of type "
            f"{JOINT_STATE}), need them" + "".join(f"; {other}" for other in others)
        )
    measurement = recordings["measurement"]
    if device is not None:
        measurement = device.understood(measurement)
    command = recordings.get("command")
    own = HEATER_CURRENT if device is None else device.drive_channel
    drive = HEATER_CURRENT if command is not None and own not in command else own
    if command is None or drive not in command:
        return measurement, problems
    channels = dict(measurement.channels)
    commanded = commanded_current(command.time_s, command[drive], measurement.time_s)
    logged = HEATER_CURRENT if device is not None else drive
    if logged in measurement:
        alone = _left_alone(command.time_s, measurement.time_s) & np.isfinite(measurement[logged])
        commanded[alone] = np.nan
        if alone.any():
            text = (
                f"{np.count_nonzero(alone)} samples come more than {_HELD:g} periods after the command before them: there the "
                "logged values are taken as the drive"
            )
            problems.append(Problem("uncommanded", f"{namespace.rstrip('/')}/command", text))
    channels[COMMANDED_CURRENT] = commanded
    unread = _unread(command.time_s, command[drive], measurement.time_s)
    return Recording(measurement.time_s, channels, measurement.device, unread), problems


def read_bag(
    path: str | Path,
    *,
    namespace: str = "/vo2",
    roles: Sequence[str] = ROLES,
    channels: Collection[str] | None = KNOWN_CHANNELS,
) -> tuple[dict[str, Recording], list[Problem]]:
    """Return the recordings of the given roles that the bag has, and what is wrong.

    Parameters
    ----------
    path, namespace : as in `read_recording`
    roles : last parts of topic names
    channels : names that are read, None for all

    Raises
    ------
    BagError : no bag, or more in it than is held in memory: 20 million stamps and values, some 0.6 GB.
    """
    problems: list[Problem] = []
    topics: dict[str, JointStates] = {}

    def wanted(channel: Channel) -> bool:
        return channel.msgtype == JOINT_STATE and channel.topic.endswith(tuple(roles))

    for count, (channel, _, data) in enumerate(raw_messages(path, problems, wanted)):
        if channel.topic not in topics:
            topics[channel.topic] = JointStates(channels)
        topics[channel.topic].add(data)
        if count % _LOOK_EVERY == 0 and (held := sum(topic.held for topic in topics.values())) > _MOST_VALUES:
            raise BagError(
                f"{path}: found {held / 1e6:.3g} million stamps and values after {count + 1} messages, need at most "
                f"{_MOST_VALUES / 1e6:g} million; record a bag for each experiment"
            )
    samples = {topic: collected.samples() for topic, collected in topics.items()}
    recordings = {}
    for role in roles:
        name = _topic_of(role, namespace, samples, problems)
        if name is None:
            text = f"no samples on this topic, nor on another .../{role} of type {JOINT_STATE}"
            if role == "command":
                text = "no commands in this bag: the logged values are taken as the drive"
            problems.append(Problem("missing_topic", f"{namespace.rstrip('/')}/{role}", text))
            continue
        recording = _recording(name, samples[name], channels, problems, regular=role != "reference")
        if len(recording):
            recordings[role] = recording
    return recordings, problems


def commanded_current(
    command_time_s: NDArray[np.float64], command: NDArray[np.float64], time_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the command that governed the interval ending at each of `time_s` (n,) [A].

    A command carries the stamp of the sample that it answers and holds from there on: the interval that ends
    at t_k is governed by the last command with a stamp before t_k. NaN where none has come yet. Of stamps that come a
    little early or late the regular instant counts, and a command within half a period of it is stamped with it.

    Parameters
    ----------
    command_time_s : (m,) stamps of the commands [s]
    """
    last = _last_before(command_time_s, time_s)[1]
    return np.where(last >= 0, command[np.maximum(last, 0)], np.nan)


def _last_before(
    command_time_s: NDArray[np.float64], time_s: NDArray[np.float64], *, missing: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Instants of the stamps (n,) [s], or those missing between them, and the command that governs the interval before each.

    Where either stamps jitter, a command counts as stamped with the instant that it is nearest to.
    """
    if time_s.size < 2:
        return time_s, np.searchsorted(command_time_s, time_s, side="left") - 1
    clock = regular_instants(time_s)
    start, period, place = clock or counted(time_s)
    instants = np.asarray(start + place * period, dtype=np.float64) if clock else time_s
    if missing:
        number = np.setdiff1d(np.arange(place[-1]), place)
        instants = np.asarray(np.interp(number, place, instants), dtype=np.float64)
    early = 0.0
    if clock or regular_instants(command_time_s):
        early = 0.5
    elif missing:
        early = 1e-3  # stamps are rounded to nanoseconds
    return instants, np.searchsorted(command_time_s, instants - early * period, side="left") - 1


def _unread(
    command_time_s: NDArray[np.float64], command: NDArray[np.float64], time_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Instants in gaps of the stamps (n,) [s] for which there is a command of their own, and the command [A]."""
    if time_s.size < 2 or not command_time_s.size:
        return None
    period = float(np.median(np.diff(time_s)))
    if not 1.5 * period < np.max(np.diff(time_s)) or time_s[-1] - time_s[0] > 2.0 * time_s.size * period:
        return None
    instants, last = _last_before(command_time_s, time_s, missing=True)
    own = (last >= 0) & (instants - command_time_s[last] < _HELD * period)
    return instants[own], command[last[own]]


def _left_alone(command_time_s: NDArray[np.float64], time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which samples (n,) no command governs any more although one came for most: who drives goes to a safe value then."""
    last = np.searchsorted(command_time_s, time_s, side="left") - 1
    if time_s.size < 2 or not np.any(last >= 0):
        return np.zeros(time_s.size, dtype=bool)
    between = np.count_nonzero((time_s >= command_time_s[0]) & (time_s <= command_time_s[-1]))
    if command_time_s.size < max(_SOME, _FOR_MOST * between):
        return np.zeros(time_s.size, dtype=bool)
    age = time_s - command_time_s[np.maximum(last, 0)]
    return np.asarray((last >= 0) & (age > _HELD * np.median(np.diff(time_s))))


def _topic_of(role: str, namespace: str, samples: dict[str, Samples], problems: list[Problem]) -> str | None:
    wanted = f"{namespace.rstrip('/')}/{role}"
    if wanted in samples:
        return wanted
    found = [name for name in samples if name.endswith(f"/{role}")] or [
        name for name in samples if name.endswith(role)
    ]
    if not found:
        return None
    best = max(sorted(found), key=lambda name: samples[name].stamp_ns.size)
    others = [name for name in found if name != best]
    text = f"read in place of {wanted}, which the bag does not have"
    if others:
        text += f"; not read: {', '.join(others)}"
    problems.append(Problem("other_namespace", best, text))
    return best


def _recording(
    topic: str, samples: Samples, channels: Collection[str] | None, problems: list[Problem], *, regular: bool
) -> Recording:
    problems.extend(
        limited([Problem("malformed", topic, reason, index=k) for k, reason in samples.malformed])
    )
    if unnamed := samples.malformed_count - len(samples.malformed):
        problems.append(Problem("more", topic, f"{unnamed} more of kind malformed"))
    kept, disorder = increasing_samples(topic, samples)
    problems.extend(disorder)
    stamp = samples.stamp_ns[kept]
    if regular:
        problems.extend(find_gaps(topic, stamp, kept))
    values = {}
    for name in samples.values:
        column = samples.values[name][kept]
        present = samples.present[name][kept]
        if not present.all():
            places = np.flatnonzero(~present)
            text = f"channel {name} is absent from {places.size} of {present.size} samples, from here on"
            problems.append(
                Problem("absent_channel", topic, text, stamp[places[0]] / 1e9, int(kept[places[0]]))
            )
        problems.extend(_not_finite(topic, name, column, present, stamp, kept))
        values[name] = np.where(np.isfinite(column), column, np.nan)
    device = max(sorted(samples.frames), key=lambda frame: samples.frames[frame], default="")
    if len(samples.frames) > 1:
        every = ", ".join(f"{frame!r} ({n})" for frame, n in sorted(samples.frames.items())[:5])
        problems.append(
            Problem("other_device", topic, f"several devices in one topic: {every}; took {device!r}")
        )
    return Recording(stamp / 1e9, values, device)


def _not_finite(
    topic: str,
    name: str,
    column: NDArray[np.float64],
    present: NDArray[np.bool_],
    stamp: NDArray[np.int64],
    kept: NDArray[np.int64],
) -> list[Problem]:
    """Return one problem per stretch of samples whose value is not a number or infinite."""
    bad = present & ~np.isfinite(column)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], bad.view(np.int8), [0]))))
    found = []
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        what = "NaN" if np.isnan(column[first:after]).all() else "not finite"
        many = (
            "" if after - first == 1 else f" in {after - first} samples, up to {stamp[after - 1] / 1e9:.9g} s"
        )
        found.append(
            Problem("nan", topic, f"channel {name} is {what}{many}", stamp[first] / 1e9, int(kept[first]))
        )
    return limited(found)
