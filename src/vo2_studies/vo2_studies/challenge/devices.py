"""Random devices around the two presets of the contract, with device-to-device spread.

Numbers not in the contract's table carry their source beside them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo2_studies.challenge.families import Film, Statistics, draw_film, major_loop

__all__ = ["PRESETS", "Device", "Preset", "Scales", "draw_device", "log_resistance", "static_deflection"]

Array = NDArray[np.floating]
ARRHENIUS = 8.617333262e-5 * np.log(10)
"""k_B ln 10 [eV/K]: log10 R = log10 R_ref + E_a / ARRHENIUS (1/T - 1/T_ref)."""


class Scales(NamedTuple):
    """How many times a rig's current, times and deflection are those of the preset it is drawn around."""

    current: float = 1.0
    time: float = 1.0
    deflection: float = 1.0


@dataclass(frozen=True)
class Preset:
    """The contract's row of one device; currents [A], temperatures [degC], deflection [m], resistance [ohm]."""

    name: str
    current_limits: tuple[float, float]
    operating: tuple[float, float]
    squared: bool
    ambient: float
    gain: float
    time_constant: float
    dead_time: float
    resistance: tuple[float, float]
    deflection: tuple[float, float]
    heating: tuple[float, float]
    width: tuple[float, float]
    offset: tuple[float, float]
    noise_log_resistance: float
    noise_deflection: float
    noise_temperature: float
    noise_current: float
    sample_period: float
    substeps: int
    has_temperature: bool
    expansion: tuple[float, float]
    scales: Scales = field(default_factory=Scales)

    def steady_temperature(self, current: Array | float) -> Array:
        """Return the nominal steady temperature [degC] at `current` [A]."""
        power = np.square(current) if self.squared else np.asarray(current)
        return np.asarray(self.ambient + self.gain * power)

    def steady_current(self, temperature: Array | float) -> Array:
        """Return the nominal current [A] that holds `temperature` [degC], within the current limits."""
        power = (np.asarray(temperature, dtype=float) - self.ambient) / self.gain
        current = np.sqrt(np.maximum(power, 0)) if self.squared else power
        return np.asarray(np.clip(current, *self.current_limits))


PRESETS = {
    "integrated": Preset(
        "integrated",
        (0.0, 12.78e-3),
        (3.68e-3, 8.49e-3),
        True,
        22.0,
        1.01e6,
        1.8e-3,
        0.0,
        (11.19e3, 231.75e3),
        (1.62e-6, 58.65e-6),
        (62.0, 3.5),
        (7.0, 2.0),
        (0.8, 1.8),
        0.002 / np.log(10),
        0.05e-6,
        0.0,
        0.4e-6,
        1e-3,
        8,
        False,
        (0.04e-6, 0.12e-6),
    ),
    "peltier": Preset(
        "peltier",
        (-1.2, 1.2),
        (0.05, -1.15),
        False,
        25.0,
        -50.0,
        25.0,
        0.375,
        (1.2e3, 120e3),
        (0.0, 70e-6),
        (64.0, 2.5),
        (7.0, 1.8),
        (0.7, 1.4),
        0.003 / np.log(10),
        0.08e-6,
        0.05,
        0.2e-3,
        0.125,
        4,
        True,
        # 2.8 of 1950 1/(m K), chapter 5, is 0.14 per cent of range a kelvin
        (0.06e-6, 0.15e-6),
    ),
}


@dataclass(frozen=True)
class Device:
    """One drawn device; units as in `Preset`.

    Attributes
    ----------
    activation : semiconducting activation energy [eV]
    log_cold, log_hot : log10 of the semiconducting resistance at the cold, of the metallic at the hot end
    metal_slope : temperature coefficient of the metallic phase, in decades per kelvin
    cold_temperature, hot_temperature : ends of the operating range [degC]
    strain : deflection by the complete structural transition [m]
    expansion_cold, expansion_hot : differential expansion k0, k1 of (5.7), as deflection per kelvin [m/K]
    rest : deflection at ambient temperature [m]
    """

    preset: Preset
    film: Film
    ambient: float
    gain: float
    time_constant: float
    dead_time: float
    activation: float
    log_cold: float
    log_hot: float
    metal_slope: float
    cold_temperature: float
    hot_temperature: float
    strain: float
    expansion_cold: float
    expansion_hot: float
    rest: float


def log_resistance(device: Device, fraction: Array, temperature: Array) -> Array:
    """Return log10 of the film resistance [ohm] (n,) by Lichtenecker's logarithmic mixing law.

    log R = (1 - s) log R_semi(T) + s log R_metal(T), the semiconductor thermally activated.
    """
    kelvin, reference = temperature + 273.15, device.cold_temperature + 273.15
    semi = device.log_cold + device.activation / ARRHENIUS * (1 / kelvin - 1 / reference)
    metal = device.log_hot + device.metal_slope * (temperature - device.hot_temperature)
    return np.asarray((1 - fraction) * semi + fraction * metal)


def static_deflection(device: Device, fraction: Array, temperature: Array) -> Array:
    """Return the tip deflection [m] (n,): phase strain minus differential expansion, (5.7) and (5.8)."""
    slope = device.expansion_cold + (device.expansion_hot - device.expansion_cold) * fraction
    return np.asarray(device.rest + device.strain * fraction - slope * (temperature - device.ambient))


def draw_device(
    rng: np.random.Generator, rig: str | Preset, *, misfit: float = 0.1, family: str = "plays"
) -> Device:
    """Draw a device around a preset or its name.

    Spread: transition mean 1 K, all widths and scales 8 per cent, time constant 8, gain and ranges 3 per cent.

    Raises
    ------
    ValueError : unknown preset
    """
    if isinstance(rig, str) and rig not in PRESETS:
        raise ValueError(f"device: found {rig!r}, need one of {', '.join(PRESETS)}")
    preset = PRESETS[rig] if isinstance(rig, str) else rig

    def spread(value: float, share: float) -> float:
        return float(value * (1 + share * np.clip(rng.standard_normal(), -2, 2)))

    statistics = Statistics(
        heating_mean=preset.heating[0] + np.clip(rng.standard_normal(), -2, 2),
        heating_sd=spread(preset.heating[1], 0.08),
        width_mean=spread(preset.width[0], 0.08),
        width_sd=spread(preset.width[1], 0.08),
        offset_mean=spread(preset.offset[0], 0.2),
        offset_sd=spread(preset.offset[1], 0.1),
        time_constant=preset.time_constant,
    )
    film = draw_film(rng, statistics, misfit=misfit, family=family)
    cold, hot = sorted(float(preset.steady_temperature(i)) for i in preset.operating)
    low, high = (spread(r, 0.03) for r in preset.resistance)
    expansion = rng.uniform(*preset.expansion)
    device = Device(
        preset=preset,
        film=film,
        ambient=preset.ambient + rng.uniform(-0.7, 0.7),
        gain=spread(preset.gain, 0.02),
        time_constant=spread(preset.time_constant, 0.08),
        dead_time=spread(preset.dead_time, 0.08),
        activation=rng.uniform(0.08, 0.2),  # eV; 0.1 to 0.3 are reported for polycrystalline films
        log_cold=np.log10(high),
        log_hot=np.log10(low),
        metal_slope=rng.uniform(0.0, 0.0006),
        cold_temperature=cold,
        hot_temperature=hot,
        strain=1.0,
        expansion_cold=expansion,
        expansion_hot=expansion * rng.uniform(1.0, 1.3),
        rest=0.0,
    )
    return _scaled(device, spread(preset.deflection[1] - preset.deflection[0], 0.03))


def _scaled(device: Device, span: float) -> Device:
    """Return `device` with strain and rest such that the major loop spans `span` [m] from the preset's low end."""
    from dataclasses import replace

    temperature = np.linspace(device.cold_temperature, device.hot_temperature, 400)
    _, _, up, down = major_loop(device.film, temperature)
    strain = span
    for _ in range(30):  # the expansion takes a share that depends on the strain: fixed-point iteration
        trial = replace(device, strain=strain)
        curve = np.concatenate([static_deflection(trial, s, temperature) for s in (up, down)])
        strain *= span / float(np.ptp(curve))
    return replace(device, strain=strain, rest=device.preset.deflection[0] - float(curve.min()))
