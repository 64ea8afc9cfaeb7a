"""What the nuisance model may absorb beside the loop's shape: constants as uncertain as fit and another day leave them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device import DeviceModel, preset
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.identification.bank_fit import BankShape, evaluate
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = [
    "ANOTHER_DAY",
    "Constant",
    "Coverage",
    "constants_of",
    "constants_of_each",
    "coverage",
    "coverage_of",
    "law_columns",
    "refitted_constants",
]

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Coverage:
    """Temperatures at which the calibration has been, bin by bin.

    Attributes
    ----------
    edges : (m + 1,) of the bins [degC]
    enough : (m,) whether the calibration has been there for some samples
    """

    edges: Floats
    enough: NDArray[np.bool_]

    def holds(self, temperature: Floats) -> NDArray[np.bool_]:
        """Whether temperatures (n,) [degC] are covered."""
        place = np.searchsorted(self.edges, temperature, side="right") - 1
        return np.concatenate([[False], self.enough, [False]])[place + 1]

    def __str__(self) -> str:
        """The stretches that are covered, in words."""
        turns = np.flatnonzero(np.diff(np.concatenate([[False], self.enough, [False]]).astype(int)))
        ends = self.edges[turns].reshape(-1, 2)
        return ", ".join(f"{low:.0f} to {high:.0f}" for low, high in ends) + " degC"


ENOUGH = 8.0
"""Least number of samples in a bin that is covered."""
BEYOND_THE_END, AT_THE_END = 0.05, 0.01
"""Shares of the calibration's range: a drive that goes beyond its end by as much as a cell of a law is wide makes the law a
guess; within the other of the opposite end nothing is remembered of it."""
PER_BIN = 4.0 * ENOUGH
"""Samples in a bin on average, below which a bin is wider than a kelvin: of few samples none would be covered otherwise."""


def _bins(low: float, high: float, count: float) -> Floats:
    """Edges (m + 1,) of bins from low to high [degC] for so many samples: whole kelvins where these are enough."""
    width = max(1.0, PER_BIN * (high - low) / max(count, 1.0))
    if width == 1.0:
        return np.arange(np.floor(low), np.ceil(high) + 1.0)
    return np.linspace(low, high, max(int((high - low) / width), 1) + 1)


def coverage(nominal: Nominal) -> Coverage:
    """Return the bins in which the calibration has enough samples.

    Elsewhere, on the way from a cold rest for instance, the fitted loops are a guess, and a recording that differs there
    says nothing about the device. The rest itself says much: no current, no heat. Everything is covered where the
    model file has no digest, and on a device without body, whose loops are fitted over all of its drive: see `from_beyond`.

    Parameters
    ----------
    nominal : fitted simulation with the digest of its calibration
    """
    digest = nominal.digest
    if digest is None or not preset(nominal.device).has_body:
        return Coverage(np.array([-np.inf, np.inf]), np.ones(1, dtype=bool))
    low = np.minimum(digest.temperature[1:], digest.temperature[:-1])
    high = np.maximum(digest.temperature[1:], digest.temperature[:-1])
    edges = _bins(float(low.min()), float(high.max()), float(digest.count.sum()))
    high = np.maximum(high, low + 1e-6)  # at rest
    # a block's samples, spread evenly over its temperatures
    shares = np.minimum(high[:, None], edges[1:]) - np.maximum(low[:, None], edges[:-1])
    shares = np.maximum(shares, 0.0) / (high - low)[:, None]
    return Coverage(edges, digest.count @ shares >= ENOUGH)


def from_beyond(path: Floats, low: float, high: float) -> NDArray[np.bool_]:
    """Whether each sample (n,) is beyond a range, or in a state that came from there: until the other end is reached.

    A hysteresis law that wipes out remembers an excursion beyond its range until the drive has been at the other end.

    Parameters
    ----------
    path : coordinate of the loops
    low, high : ends of the range
    """
    place, none = np.arange(1, path.size + 1), 0
    slack = BEYOND_THE_END * (high - low)

    def latest(where: NDArray[np.bool_]) -> NDArray[np.int64]:
        return np.maximum.accumulate(np.where(where, place, none))

    above, below = latest(path > high + slack), latest(path < low - slack)
    near = AT_THE_END * (high - low)
    at_high, at_low = latest(path >= high - near), latest(path <= low + near)
    return (above > at_low) | (below > at_high)


def coverage_of(paths: Sequence[Floats]) -> Coverage:
    """Return the bins in which recordings have enough samples on average.

    Parameters
    ----------
    paths : temperatures (n,) of each recording [degC]
    """
    every = np.concatenate(paths)
    low, high = float(every.min()), float(every.max())
    edges = _bins(low, np.nextafter(high, np.inf), every.size / len(paths))
    return Coverage(edges, np.histogram(every, edges)[0] >= ENOUGH * len(paths))


@dataclass(frozen=True)
class Constant:
    """One way in which a constant of the device may differ from the model file's.

    Attributes
    ----------
    name : as in the model file (`thermal.ambient`), or `deflection.zero`, `deflection.gain`, `resistance.gain`
    unit : of its value
    value : of the model; 0 for a zero, 1 for a gain
    spread : standard deviation beforehand, in `unit`
    drifts : True where the device has changed since its calibration, and the loops are as they were calibrated; False
        where the calibration did not know better, and the loops go along with the lags
    straight : move, in units of `spread`, over which the simulation is linear in it
    part : place of the recording that it is of, beside what it is in all; None where it is the same in all
    """

    name: str
    unit: str
    value: float
    spread: float
    drifts: bool = False
    straight: float = 1.0
    part: int | None = None

    @property
    def held(self) -> bool:
        """Whether it stays where the calibration left it while an effect is sought in its place: not a day's room."""
        return self.drifts and self.part is None


ANOTHER_DAY = {
    "thermal.ambient": ("degC", 1.0),
    "thermal.linear_gain": ("K/A", 0.005),
    "thermal.square_gain": ("K/A^2", 0.005),
    "thermal.power_gain": ("K/W", 0.005),
    "thermal.time_constant": ("s", 0.05),
    "driver.dead_time": ("s", 0.01),
    "deflection.zero": ("m", 0.01),
    "deflection.gain": ("1", 0.01),
    "resistance.gain": ("1", 0.01),
}
"""Unit, and standard deviation of what differs between two days of an unchanged rig: of the ambient in kelvin, of the
deflection's zero as a share of its range, of the others as a share of the value. A room is held within 1 K, a thermal
grease or a clamp set anew changes a time constant by some per cent but no dead time, an optical lever is aligned to some
tenths of a micrometre, a meter keeps its gain within a per cent. Assumed: no statistics over days are published."""
OF_A_DAY = ("thermal.ambient", "deflection.zero")
"""Of these what is hardly the same on two days: the room, where there is a body that is in it, and the zero."""
OF_A_RESPONSE = 0.05
"""The same of zero and gain on a device without body, of which nothing is known: an amplifier, a load cell, a clamp."""


def constants_of(nominal: Nominal) -> tuple[Constant, ...]:
    """Return the constants that a refit may move: as uncertain as the calibration left them, and as they differ from day to day.

    Parameters
    ----------
    nominal : fitted simulation
    """
    return (*_calibrated(nominal.model), *_drifting(nominal))


def constants_of_each(nominal: Nominal, recordings: int, calibrations: int) -> tuple[Constant, ...]:
    """Return what may be another one in each of several recordings, which are of a day each, beside what it is in all of them.

    Where calibrations are among the recordings, and the device is fitted anew, it is told from the first.

    Parameters
    ----------
    nominal : fitted simulation
    recordings, calibrations : number of all, and of the first ones that are calibrations
    """
    body = preset(nominal.device).has_body
    of_a_day = [c for c in _drifting(nominal) if c.name == OF_A_DAY[1] or (body and c.name == OF_A_DAY[0])]
    parts = range(min(calibrations, 1), recordings) if recordings > 1 else ()
    return tuple(replace(c, part=k) for k in parts for c in of_a_day)


REFITTED = {
    "thermal.ambient": 2.0,
    "thermal.linear_gain": 0.05,
    "thermal.square_gain": 0.05,
    "thermal.time_constant": 0.5,
    "driver.dead_time": 1.0,
}
"""Standard deviation, in kelvin for the ambient and as a share of the value for the others, of what a fit of the nominal
device may have taken up of an effect that was there in its calibration: a slow sensor doubles the time constant of a
quick device, a slow parallel mode of some per cent changes the gain by as much."""


def refitted_constants(nominal: Nominal) -> tuple[Constant, ...]:
    """Return the constants that are fitted anew where the effect may have been there in the calibration.

    Where no temperature is measured, ambient and gain are the scale that temperature is expressed in: with the loops fitted
    anew as well they would only trade with them.

    Parameters
    ----------
    nominal : fitted simulation
    """
    found = []
    scale = () if preset(nominal.device).measures_temperature else ("ambient", "linear_gain", "square_gain")
    for name, spread in REFITTED.items():
        if name.partition(".")[2] in scale:
            continue
        value = nominal.model.scalars[name]
        size = spread if name == "thermal.ambient" else abs(value) * spread
        if size > 0.0:
            found.append(Constant(name, ANOTHER_DAY[name][0], value, size, drifts=True, straight=0.05))
    return tuple(found)


LAW = (0.3, 1.0, 0.3, 0.5, 0.1)
"""Standard deviation of what a fit of the nominal law may be off by where an effect was in its calibration: of the
logarithm of a play's slope, its centre [K], the logarithms of its half width and weight, and a coefficient of the
polynomial as a share of the range. A loop that took up a creep has plays of its own for that."""


def law_columns(nominal: Nominal, channel: str, path: Floats) -> Floats:
    """Return the change (n, l) of a channel by each parameter of its fitted law, each scaled to a unit normal.

    None, l = 0, for a law that no fit wrote.

    Parameters
    ----------
    nominal : fitted simulation
    channel : resistance or deflection
    path : (n,) temperature from a cold rest [degC]
    """
    bank = nominal.model.resistance if channel == RESISTANCE else nominal.model.deflection
    try:
        shape = BankShape.of_bank(bank)
    except ValueError:
        return np.zeros((path.size, 0))
    plays = shape.centre.size
    spread = np.concatenate(
        [
            np.repeat(LAW[:4], plays),
            np.full(shape.polynomial.size, LAW[4] * nominal.span[channel]),
        ]
    )
    # the law is that of -log10 R
    sign = -1.0 if channel == RESISTANCE else 1.0
    return np.asarray(sign * evaluate(shape, path)[1] * spread)


def _calibrated(model: DeviceModel) -> list[Constant]:
    """Thermal constants within the fit's own standard deviation.

    With a floor for what differs between two recordings of an unchanged device, and a default for a model file without
    deviations. Ambient and gain have next to none: without a temperature sensor they are the scale that temperature is
    expressed in, and they are the same for both recordings.
    """
    floors = {
        "thermal.time_constant": (0.003, 0.10),
        "driver.dead_time": (0.003, 0.10),
        "thermal.linear_gain": (1e-4, 1e-4),
        "thermal.square_gain": (1e-4, 1e-4),
    }
    found = []
    for name, (floor, default) in floors.items():
        value = model.scalars[name]
        known = model.uncertainty.get(name)
        # a dead time of nothing is as uncertain as the fit says, too
        spread = max(known[0] if known else abs(value) * default, abs(value) * floor)
        if spread > 0.0:
            found.append(Constant(name, ANOTHER_DAY[name][0], value, spread))
    name = "thermal.ambient"
    known = model.uncertainty.get(name)
    spread = max(known[0] if known else 0.0, 0.01)
    return [*found, Constant(name, ANOTHER_DAY[name][0], model.scalars[name], spread)]


def _drifting(nominal: Nominal) -> list[Constant]:
    """Constants that another day may have moved, sensors included."""
    model, found = nominal.model, []
    for name, (unit, spread) in ANOTHER_DAY.items():
        section, _, what = name.partition(".")
        if section in ("thermal", "driver"):
            value = model.scalars[name]
            size = spread if name == "thermal.ambient" else abs(value) * spread
            if size == 0.0:
                continue
        else:
            if not getattr(model, section).present:
                continue
            value = 0.0 if what == "zero" else 1.0
            spread = spread if preset(nominal.device).has_body else OF_A_RESPONSE
            size = spread * nominal.span[TIP_DEFLECTION] if what == "zero" else spread
        found.append(Constant(name, unit, value, size, drifts=True, straight=0.1))
    return found
