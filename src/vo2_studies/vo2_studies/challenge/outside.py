"""Physics outside every catalogue, composed at random: a place in the chain, what it depends on, and a memory.

    change at the place = amplitude * memory(f(u)),    u = what it depends on, scaled to -1..1

f is a sum of three sinusoids of random, incommensurate wave numbers, so that it is no drift, no power law and not
periodic; the memory is none, a first-order lag, a half-order memory, or a play. No list of such kinds can be learned.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

from vo2_studies.challenge.devices import Device
from vo2_studies.challenge.effect import ANY, ConcealedEffect, Context, log_uniform
from vo2_studies.challenge.filters import backlash, half_order, lag
from vo2_studies.challenge.rig import Plan

__all__ = ["COMPOSED", "PLACES", "describe", "families_of"]

Array = NDArray[np.floating]
Values = dict[str, float]
Draw = dict[str, tuple[float, str]]
PLACES = (
    "drive",
    "heat",
    "transition",
    "film",
    "structure",
    *(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
)
DEPENDENCES = {
    "drive": ("drive", "time"),
    "heat": ("drive",),
    "transition": ("drive", "time"),
    "film": ("temperature", "drive", "time"),
    "structure": ("temperature", "fraction", "time"),
    RESISTANCE: ("output", "time"),
    TIP_DEFLECTION: ("output", "time"),
    STAGE_TEMPERATURE: ("output", "time"),
}
"""Place -> what its change may depend on. A slow change of the room or of a sensor with time is in the catalogue."""
MEMORIES = ("none", "lag", "half order", "play")
AMPLITUDES = {
    "drive": (0.002, 0.03),
    "heat": (0.1, 2.0),
    "transition": (0.1, 2.0),
    "film": (0.006, 0.06),
    "structure": (0.003, 0.04),
    RESISTANCE: (0.006, 0.06),
    TIP_DEFLECTION: (0.003, 0.04),
    STAGE_TEMPERATURE: (0.1, 1.5),
}
"""Place -> range of the amplitude: share of the largest current, kelvin, kelvin, decades, share of the range, decades,
share of the range, kelvin."""


def describe(values: Values) -> dict[str, str]:
    """Return place, dependence and memory of a drawn composition in words."""
    place = PLACES[int(values["place"])]
    depends = DEPENDENCES[place][int(values["dependence"])]
    return {"place": place, "dependence": depends, "memory": MEMORIES[int(values["memory"])]}


def families_of(values: Values) -> tuple[str, ...]:
    """Return the contract's family of a composition, then what no recording of these channels tells from it."""
    words = describe(values)
    place, depends = words["place"], words["dependence"]
    if place in (RESISTANCE, "film"):
        both = ("film", f"sensor:{RESISTANCE}")
        return both if place == "film" else both[::-1]
    if place in (TIP_DEFLECTION, "structure"):
        both = ("structure", f"sensor:{TIP_DEFLECTION}")
        return both if place == "structure" else both[::-1]
    if place == STAGE_TEMPERATURE:
        return (f"sensor:{STAGE_TEMPERATURE}",)
    if place == "transition":
        # without a thermometer on the body only the transition shows its temperature
        return ("transition", "heat") if depends == "time" else ("transition",)
    # heat that depends on the drive is another drive
    return ("drive", "heat") if place == "drive" else ("heat", "drive")


def _draw(c: Context) -> Draw:
    places = [p for p in PLACES if p != STAGE_TEMPERATURE or c.preset.has_temperature]
    place = str(c.rng.choice(places))
    depends = int(c.rng.integers(len(DEPENDENCES[place])))
    in_time = DEPENDENCES[place][depends] == "time"
    # waves over the range of u: some of a quantity, many over the recording, where few would be a drift
    low, high = (20.0, 80.0) if in_time else (0.8, 2.5)
    waves = log_uniform(c.rng, low, high) * np.array([1.0, *c.rng.uniform(1.2, 1.9, 2)])
    values = {
        "place": (float(PLACES.index(place)), "1"),
        "dependence": (float(depends), "1"),
        "memory": (float(c.rng.integers(len(MEMORIES))), "1"),
        "amplitude": (log_uniform(c.rng, *AMPLITUDES[place]), "1"),
        "time_constant": (c.duration * log_uniform(c.rng, 0.0005, 0.02), "s"),
        "half_width": (float(c.rng.uniform(0.1, 0.5)), "1"),
    }
    for k in range(3):
        values |= {
            f"waves_{k}": (float(waves[k]), "1"),
            f"phase_{k}": (float(c.rng.uniform(0, 6.283)), "rad"),
        }
    return values


def _apply(plan: Plan, v: Values, c: Context) -> None:
    words = describe(v)
    place, depends = words["place"], words["dependence"]
    cold, hot = c.device.cold_temperature, c.device.hot_temperature
    scale: dict[str, Callable[[Array], Array]] = {
        "time": lambda x: _unit(x, 0.0, c.duration),
        "drive": lambda x: _unit(x, *sorted(c.preset.operating)),
        "temperature": lambda x: _unit(x, cold, hot),
        "fraction": lambda x: _unit(x, 0.0, 1.0),
        RESISTANCE: lambda x: _unit(np.log10(x), *np.log10(c.preset.resistance)),
        TIP_DEFLECTION: lambda x: _unit(x, *c.preset.deflection),
        STAGE_TEMPERATURE: lambda x: _unit(x, cold, hot),
    }
    low, high = c.preset.deflection

    def change(x: Array, step: float) -> Array:
        u = scale[place if depends == "output" else depends](x)
        if words["memory"] == "play":
            u = backlash(u, v["half_width"] if depends != "time" else 0.0)
        y = np.sum([np.sin(np.pi * v[f"waves_{k}"] * u + v[f"phase_{k}"]) for k in range(3)], axis=0)
        if words["memory"] == "lag":
            y = lag(y, step, v["time_constant"])
        elif words["memory"] == "half order":
            y = half_order(y, step, v["time_constant"]) + y[0]
        return np.asarray(v["amplitude"] * y)

    if place == "drive":
        largest = max(abs(i) for i in c.preset.operating)

        def drive(i: Array, step: float) -> Array:
            return i + largest * change(np.arange(i.size) * step if depends == "time" else i, step)

        plan.driver.append(drive)
    elif place == "heat":
        plan.heat.append(lambda power, step: change(c.preset.steady_current(power + c.preset.ambient), step))
    elif place == "transition":
        plan.shift.append(lambda t, i: change(t if depends == "time" else i, float(t[1] - t[0])))
    elif place == "film":

        def film(t: Array, resistance: Array, temperature: Array, current: Array) -> Array:
            x = {"time": t, "temperature": temperature, "drive": current}[depends]
            return resistance * 10 ** change(x, float(t[1] - t[0]))

        plan.film.append(film)
    elif place == "structure":

        def bend(t: Array, deflection: Array, temperature: Array, structure: Array, device: Device) -> Array:
            x = {"time": t, "temperature": temperature, "fraction": structure}[depends]
            return deflection + (high - low) * change(x, float(t[1] - t[0]))

        plan.structure.append(bend)
    else:

        def read(t: Array, step: float, y: Array) -> Array:
            dy = change(t if depends == "time" else y, step)
            if place == RESISTANCE:
                return np.asarray(y * 10**dy)
            return np.asarray(y + dy * (high - low if place == TIP_DEFLECTION else 1.0))

        plan.readout.append((place, read))


def _unit(x: Array, low: float, high: float) -> Array:
    return np.asarray(2 * (x - low) / (high - low) - 1)


COMPOSED = ConcealedEffect("composed", ANY, _draw, _apply, {"amplitude": 0.0})
