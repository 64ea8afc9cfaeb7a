"""Effects that measured values show by themselves, as a coarse or a clipping converter does, before anything is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import surrogate_of_temperature
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nominal import Nominal, Response
from vo2_models.diagnosis.part import Part
from vo2_models.diagnosis.result import Location
from vo2_models.effects import Effect, effects
from vo2_models.recording import RESISTANCE

__all__ = ["Evident", "evident_effects", "located_with", "untold_steps", "without_lines"]

QUIET = 1e-3
"""Share of the noise that counts for none."""


@dataclass(frozen=True)
class Evident:
    """One effect that was read off the values of a channel.

    Attributes
    ----------
    record : of the catalogue
    signal : the channel
    values : its parameters, in their units
    share : share of the channel's samples at which it acts
    before, after : r.m.s. distance of recording and simulation at these samples without and with it, in the judged unit
    energy : of what it changes, in units of the noise power
    location : of these samples, its share not set
    deviations : standard deviations of the parameters; empty where they are read as they were written
    """

    record: Effect
    signal: str
    values: Mapping[str, float]
    share: float
    before: float
    after: float
    energy: float
    location: Location
    deviations: Mapping[str, float] = field(default_factory=dict)

    @property
    def explained(self) -> float:
        """Share of the channel's squared error at these samples that it takes away, 0 to 1."""
        share = 1.0 - (self.after / self.before) ** 2 if self.before > 0.0 else 0.0
        return float(np.clip(share, 0.0, 1.0))

    @property
    def effects(self) -> dict[str, dict[str, float | str]]:
        """What `Simulation.with_effects` takes."""
        return {f"{self.record.id}:{self.signal}": {**self.values, "signal": self.signal}}


def evident_effects(
    started: Sequence[tuple[Part, Response]], nominal: Nominal, limits: Limits, *, first_use: bool
) -> tuple[Evident, ...]:
    """Return what the values show that the simulation lacks, each effect of each channel once.

    A converter that the calibration had as well is in its noise or in its loops. What is new changes the simulation by more
    than that noise. Where calibrations are among the recordings it need not be new: a comb must then be most of the noise.

    Parameters
    ----------
    started : recordings with the response of the simulation
    nominal : fitted simulation
    limits : when a converter is coarser than noise
    first_use : whether calibrations are among the recordings
    """
    found: dict[tuple[str, str], Evident] = {}
    # what a converter does to the values themselves: on average over a noise it may do nothing
    quiet = replace(nominal, noise={c: noise.scaled(QUIET) for c, noise in nominal.noise.items()})
    for part, response in started:
        for (name, channel), values in part.evident.items():
            key = f"{name}:{channel}"
            if (name, channel) in found or key in nominal.model.effects or channel not in nominal.noise:
                continue
            if not first_use and _known(values, channel, nominal, limits):
                continue
            flat = part.flat.get(name, {}).get(channel)
            acting: NDArray[np.bool_] = part.valid[channel] if flat is None else flat
            given: dict[str, float | str] = {**values, "signal": channel}
            there = quiet.respond(part.current, part.dt, effects={key: given}, settled=part.settled)
            plain, changed = response.channels[channel][acting], there.channels[channel][acting]
            noise = nominal.noise[channel].level
            if flat is not None:
                noise = float(np.hypot(noise, np.max(part.comb_level(channel))))
            least = noise * (limits.coarse if flat is not None or not first_use else 1.0 / limits.coarse)
            if _rms(changed - plain) > least or (flat is not None and first_use):
                seen = part.observed[channel][acting]
                found[name, channel] = Evident(
                    effects()[name],
                    channel,
                    values,
                    float(np.mean(acting[part.valid[channel] | acting])),
                    _rms(seen - plain),
                    _rms(seen - changed),
                    float(np.sum((changed - plain) ** 2)) / nominal.noise[channel].level ** 2,
                    _location(channel, part, acting, response.temperature[acting], nominal.device),
                )
    return tuple(found.values())


def untold_steps(
    parts: Sequence[Part], nominal: Nominal, evident: Sequence[Evident], limits: Limits
) -> list[str]:
    """Return a sentence for each channel whose converter has become coarser than its sensor's noise, but not than the misfit.

    Parameters
    ----------
    parts : recordings
    nominal : fitted simulation
    evident : what is told as an effect
    limits : when two converters are the same
    """
    named = {one.signal for one in evident if "step" in one.values}
    device = nominal.model.description
    return [
        f"{part.name}: the values of {channel} lie {step:.4g} {device.units.get(channel, '')} apart, other than in the "
        "calibration: no more than the law misses, so that no effect is named for it"
        for part in parts
        for channel, step in part.comb.items()
        if channel not in named and not _known({"step": step}, channel, nominal, limits)
    ]


def without_lines(
    started: Sequence[tuple[Part, Response]], nominal: Nominal, limits: Limits, *, first_use: bool
) -> tuple[list[tuple[Part, Response]], tuple[Evident, ...], list[str]]:
    """Take what is added to single channels at one frequency all the time out of recordings, and return what it was.

    A line of the calibration is in its noise: only one that is more than that is new. What swings in several channels of a
    recording, the drive that is read back among them, is none of a sensor's: it stays, with a sentence that says so.

    Parameters
    ----------
    started : recordings with the response of the simulation
    nominal : fitted simulation
    limits : when it is coarser than noise
    first_use : whether calibrations are among the recordings, so that it need not be new
    """
    judged, found, told = [], dict[str, Evident](), []
    for part, response in started:
        for record in (one for one in effects().values() if "line" in one.hooks):
            seen = {
                channel: line
                for channel in part.channels
                if (line := _line(record, channel, part, response, nominal)) is not None
            }
            for channel, (values, deviations) in seen.items():
                key = f"{record.id}:{channel}"
                if channel not in record.channels or key in nominal.model.effects:
                    continue
                given: dict[str, float | str] = {**values, "signal": channel}
                with_it = nominal.respond(part.current, part.dt, effects={key: given}, settled=part.settled)
                added = with_it.channels[channel] - response.channels[channel]
                good, noise = part.valid[channel], nominal.noise[channel].level
                if not _rms(added[good]) > noise * (1.0 / limits.coarse if first_use else limits.coarse):
                    continue
                apart = 2.0 / (part.size * part.dt)
                if others := [
                    c
                    for c, (other, _) in seen.items()
                    if c != channel and abs(other["frequency"] - values["frequency"]) < apart
                ]:
                    told.append(
                        f"{part.name}: {channel} swings at {values['frequency']:.4g} Hz, and so does {', '.join(others)}: "
                        "the drive, the room or the mounting, not one sensor"
                    )
                    continue
                before = part.observed[channel] - response.channels[channel]
                part = replace(part, observed={**part.observed, channel: part.observed[channel] - added})
                found.setdefault(
                    key,
                    Evident(
                        record, channel, values, 1.0, _rms(before[good]), _rms((before - added)[good]),
                        float(np.sum(added[good] ** 2)) / noise**2,
                        _location(channel, part, good, response.temperature[good], nominal.device),
                        deviations,
                    ),
                )  # fmt: skip
        judged.append((part, response))
    return judged, tuple(found.values()), told


def _line(
    record: Effect, channel: str, part: Part, response: Response, nominal: Nominal
) -> tuple[Mapping[str, float], Mapping[str, float]] | None:
    """Parameters of what swings in a channel, and their deviations, see `effects.record.PLAIN`."""
    if channel not in nominal.noise:
        return None
    level = nominal.noise[channel].level * part.uneven.get(channel, np.ones(part.size))
    seen, simulated = part.observed[channel], response.channels[channel]
    if channel == RESISTANCE:
        seen, simulated = 10.0**seen, 10.0**simulated
        level = np.log(10.0) * level * simulated
    left = np.where(part.valid[channel], seen - simulated, np.nan)
    found: tuple[Mapping[str, float], Mapping[str, float]] | None = record.hooks["line"](
        left, level, simulated, part.dt
    )
    return found


def _known(values: Mapping[str, float], channel: str, nominal: Nominal, limits: Limits) -> bool:
    """Whether the calibration's values lay on the same comb, or on a coarser one."""
    before = nominal.digest.steps.get(channel, 0.0) if nominal.digest else 0.0
    return "step" in values and values["step"] < limits.same_steps * before


def located_with(evident: Sequence[Evident], rest: Sequence[Location], energy: float) -> list[Location]:
    """Return where recording and simulation differ, all shares of one sum, most first.

    Parameters
    ----------
    evident : what the values show
    rest : where the other excess is
    energy : of that excess, in units of the noise power
    """
    found = {place.signal: replace(place, share=place.share * energy) for place in rest}
    for one in evident:
        before = found.get(one.signal)
        found[one.signal] = replace(
            before or one.location, share=(before.share if before else 0.0) + one.energy
        )
    total = sum(place.share for place in found.values())
    places = [replace(place, share=place.share / total) for place in found.values()]
    return sorted(places, key=lambda place: -place.share)


def _location(
    channel: str, part: Part, acting: NDArray[np.bool_], temperature: NDArray[np.float64], device: str
) -> Location:
    """These samples as a place, each run of them an interval; the film's middle 80 % of temperatures there [degC]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], acting, [False]]).astype(int)))
    begin, end = part.time_s[edges[::2]], part.time_s[edges[1::2] - 1] + part.dt
    low, high = np.quantile(temperature, [0.1, 0.9])
    return Location(
        channel,
        0.0,
        np.column_stack([begin, end]).tolist(),
        "both",
        [float(low), float(high)],
        np.sort(surrogate_of_temperature(device, [low, high])).tolist(),
        [0.0, 0.5 / part.dt],
    )


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
