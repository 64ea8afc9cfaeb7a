"""Recordings as rigs make them: when commands are stamped, when sensors are read, and what goes missing on the way.

clean    as the contract says: a command governs the interval that starts with its stamp
end      commands stamped with the end of their interval
late     commands stamped off by a constant, up to two and a half periods either way
jitter   sensors read up to a quarter of a period off the instants of the commands, at true stamps
missing  5 % of the samples lost, single ones and short bursts
outliers 0.4 % of each channel's samples off by 8 to 60 standard deviations
rates    one channel read at every second, third or fourth sample only
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from vo2_identification.bags import BagWriter
from vo2_identification.bags.joint_state import encode
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

from vo2_studies.challenge.rig import Noise

__all__ = ["CONDITIONS", "Condition", "draw_condition", "write_recording"]

Array = NDArray[np.floating]
CONDITIONS = ("clean", "end", "late", "jitter", "missing", "outliers", "rates")
JITTER, MISSING, OUTLIERS = 0.25, 0.05, 0.004


@dataclass(frozen=True)
class Condition:
    """What a rig does to all its recordings.

    Attributes
    ----------
    name : one of `CONDITIONS`
    command_shift : stamps of commands minus the start of their interval [s]
    jitter : largest distance of a reading from its command [s]
    missing, outliers : shares of samples
    slow_channel, every : a channel that is read at each `every`-th sample only
    """

    name: str
    command_shift: float = 0.0
    jitter: float = 0.0
    missing: float = 0.0
    outliers: float = 0.0
    slow_channel: str = ""
    every: int = 1

    def draw_jitter(self, rng: np.random.Generator, samples: int) -> Array | None:
        """Return the readings' distances from the commands (n,) [s], None without jitter."""
        return rng.uniform(-self.jitter, self.jitter, samples) if self.jitter else None

    def spoil(self, rng: np.random.Generator, recording: Recording, noise: Noise) -> Recording:
        """Return what is left of a recording; NaN where a sample of a channel is missing."""
        channels = {name: values.copy() for name, values in recording.channels.items()}
        n = len(recording)
        for name in channels if self.outliers else ():
            if name in (COMMANDED_CURRENT, HEATER_CURRENT):
                continue
            where = rng.random(n) < self.outliers
            size = noise[name].sd * np.exp(rng.uniform(np.log(8), np.log(60), n)) * rng.choice([-1, 1], n)
            off = channels[name] * 10**size if name == RESISTANCE else channels[name] + size
            channels[name] = np.where(where, off, channels[name])
        if self.slow_channel:
            read = np.arange(n) % self.every == 0
            channels[self.slow_channel] = np.where(read, channels[self.slow_channel], np.nan)
        spoiled = Recording(recording.time_s, channels, recording.device)
        if not self.missing:
            return spoiled
        lost = rng.random(n) < self.missing / 2
        for start in np.flatnonzero(rng.random(n) < self.missing / 2 / 5.0):  # bursts of 5 on average
            lost[start : start + 1 + int(rng.geometric(0.2))] = True
        lost[:2] = False
        return Recording(
            spoiled.time_s[~lost], {name: v[~lost] for name, v in channels.items()}, recording.device
        )


def draw_condition(
    rng: np.random.Generator, name: str, period: float, channels: tuple[str, ...]
) -> Condition:
    """Draw the details of condition `name` for a rig with a sample period [s] and sensor channels.

    Raises
    ------
    ValueError : unknown name.
    """
    if name not in CONDITIONS:
        raise ValueError(f"conditions: found {name!r}, need one of {', '.join(CONDITIONS)}")
    if name == "end":
        return Condition(name, command_shift=period)
    if name == "late":
        return Condition(name, command_shift=float(rng.uniform(0.3, 2.5) * rng.choice([-1, 1])) * period)
    if name == "jitter":
        return Condition(name, jitter=JITTER * period)
    if name == "missing":
        return Condition(name, missing=MISSING)
    if name == "outliers":
        return Condition(name, outliers=OUTLIERS)
    if name == "rates":
        slow = [c for c in channels if c in (TIP_DEFLECTION, STAGE_TEMPERATURE)]
        return Condition(name, slow_channel=str(rng.choice(slow)), every=int(rng.integers(2, 5)))
    return Condition(name)


def write_recording(
    path: Path, measurement: Recording, commands: tuple[Array, Array] | None, namespace: str = "/vo2"
) -> Path:
    """Write a bag: measurements without the channels that a sample does not have, commands with their own stamps [s].

    `commands` are stamps (m,) [s] and currents (m,) [A], None where the rig recorded none.
    """
    names = [name for name in measurement.channels if name != COMMANDED_CURRENT]
    values = np.column_stack([measurement[name] for name in names])
    stamps = np.rint(measurement.time_s * 1e9).astype(np.int64)
    present = ~np.isnan(values)
    messages: list[tuple[int, int, bytes]] = []
    for pattern in np.unique(present, axis=0):
        rows = np.flatnonzero((present == pattern).all(axis=1))
        kept = [name for name, there in zip(names, pattern, strict=True) if there]
        encoded = encode(stamps[rows], kept, values[rows][:, pattern], measurement.device)
        messages += [(int(stamps[k]), 0, text) for k, text in zip(rows, encoded, strict=True)]
    roles = ["measurement"]
    if commands is not None:
        roles.append("command")
        when = np.rint(commands[0] * 1e9).astype(np.int64)
        values = np.asarray(commands[1], dtype=np.float64)[:, None]
        encoded = encode(when, [HEATER_CURRENT], values, measurement.device)
        messages += [(int(stamp), 1, text) for stamp, text in zip(when, encoded, strict=True)]
    with BagWriter(path, flush_period_s=float("inf")) as bag:
        topics = [bag.add_topic(f"{namespace}/{role}", "sensor_msgs/msg/JointState") for role in roles]
        for stamp, topic, text in sorted(messages, key=lambda message: message[:2]):
            bag.write(topics[topic], stamp, text)
    return path
