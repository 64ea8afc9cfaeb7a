"""The simulated device under test: a dense ensemble of switching domains in a continuous-time thermal model.

It is never fitted and shares no hysteresis law with the models that are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from vo2_models.device.coefficients import Coefficient, Sensor, sensor_index
from vo2_models.device.description import DeviceDescription, preset
from vo2_models.device.ensemble import population, sort_population
from vo2_models.device.laws import truth_deflection
from vo2_models.device.simulation import ENSEMBLE, Simulation, nominal_coefficients
from vo2_models.device.stepper import Stepper
from vo2_models.recording import RESISTANCE

__all__ = ["DOMAINS", "SPREAD", "TruthDevice", "truth"]

DOMAINS = 4000
"""Number of switching domains of a device."""

_NEAR_UM, _STEPS = 1e-11, 20
"""Distance from the published range at which the bending is found [um], and most of Newton's steps to there."""
SPREAD = {
    "heating": 0.6,
    "heating_sd": 0.05,
    "width": 0.05,
    "resistance": 0.05,
    "activation": 0.05,
    "threshold": 0.03,
    "bending": 0.02,
    "expansion": 0.05,
    "time_constant": 0.03,
    "dead_time": 0.03,
}
"""Device-to-device standard deviation: kelvin for `heating`, relative for the others. Assumed: no statistics over
many devices are published; chapters 4, 7 and 8 differ among each other by more."""


@dataclass(frozen=True)
class TruthDevice(Simulation):
    """A simulated device; make it with `truth`. It behaves as its `Simulation` and can be stepped."""

    def stepper(self, *, dt: float | None = None, seed: int = 0, noise: bool = True) -> Stepper:
        """Return the device as a stream, bit-identical to `simulate` with the same arguments."""
        return Stepper(self, dt=dt, seed=seed, noise=noise)


def truth(
    name: str,
    *,
    seed: int | None = None,
    effects: Mapping[str, Mapping[str, float | str]] | None = None,
    spread: float = 1.0,
    domains: int = DOMAINS,
    colour: float = 0.0,
) -> TruthDevice:
    """Return a simulated device.

    Parameters
    ----------
    name : id of a shipped device, or path of a device file that tells film and structure
    seed : draws the device's own parameters and domains; None gives the nominal device, which spans the published ranges
    effects : physics beyond the nominal device, `{id: {parameter: value}}`
    spread : scales the device-to-device spread `SPREAD`
    domains : number of switching domains
    colour : AR(1) coefficient of the measurement noise, 0 for white

    Raises
    ------
    ValueError : unknown device or effect, a device whose material is not told, a parameter out of its range.
    """
    nominal = preset(name)
    name = nominal.key
    drawn = _draw(nominal, seed, spread)
    c = _calibrated(name, domains).copy()
    c[Coefficient.TIME_CONSTANT] *= drawn["time_constant"]
    c[Coefficient.DEAD_TIME] *= drawn["dead_time"]
    for index in (Coefficient.INSULATOR, Coefficient.METAL):
        c[index] *= drawn["resistance"]
    c[Coefficient.ACTIVATION] *= drawn["activation"]
    c[Coefficient.THRESHOLD] *= drawn["threshold"]
    c[Coefficient.BENDING] *= drawn["bending"]
    for index in (Coefficient.EXPANSION_COLD, Coefficient.EXPANSION_HOT):
        c[index] *= drawn["expansion"]
    alpha, beta, offset = population(
        domains,
        heating=(nominal.heating[0] + drawn["heating"], nominal.heating[1] * drawn["heating_sd"]),
        width=(nominal.width[0] * drawn["width"], nominal.width[1]),
        offset=nominal.offset,
        seed=seed,
    )
    metallic = sort_population(alpha, beta)
    structural = sort_population(alpha + offset, beta + offset)
    for channel in nominal.channels:
        c[sensor_index(channel, Sensor.COLOUR)] = colour
    device = TruthDevice(
        device=name,
        kind=ENSEMBLE,
        coefficients=c,
        levels=np.ascontiguousarray([metallic[0], structural[0]]),
        domains=np.ascontiguousarray([metallic[1], structural[1]]),
        steps_per_constant=16.0,
    )
    return replace(device, coefficients=device.with_effects(effects or {}).coefficients)


def _draw(nominal: DeviceDescription, seed: int | None, spread: float) -> dict[str, float]:
    """Factors (and the shift `heating` in kelvin) of one device; the neutral ones without seed."""
    if seed is None:
        return {key: 0.0 if key == "heating" else 1.0 for key in SPREAD}
    names = list(SPREAD)
    # a stream of its own, so that the domains do not depend on how many parameters have a spread
    entropy = [seed, sum(nominal.id.encode())]
    normal = np.random.default_rng(entropy).standard_normal(len(names)).clip(-2.5, 2.5)
    return {
        key: spread * SPREAD[key] * z if key == "heating" else 1.0 + spread * SPREAD[key] * z
        for key, z in zip(names, normal, strict=True)
    }


@lru_cache(maxsize=8)
def _calibrated(name: str, domains: int) -> np.ndarray:
    """Coefficients of the nominal device, computed so that its major loop spans the published ranges."""
    nominal = preset(name)
    sites = nominal.sites
    if sites is None:
        raise ValueError(
            f"device {nominal.id}: its file has no film, or no structure with expansion: its material cannot be simulated; "
            "fit a model and run that"
        )
    c = nominal_coefficients(nominal)
    cold, hot = (nominal.steady_temperature(current) for current in nominal.operating_range)
    c[Coefficient.METAL], c[Coefficient.INSULATOR] = nominal.resistance_range
    c[Coefficient.REFERENCE_LOW], c[Coefficient.REFERENCE_HIGH] = cold, hot
    c[Coefficient.ACTIVATION] = sites.activation
    c[Coefficient.METAL_SLOPE] = sites.metal_slope
    c[Coefficient.THRESHOLD] = sites.threshold
    c[Coefficient.LENGTH] = nominal.length
    c[Coefficient.EXPANSION_COLD], c[Coefficient.EXPANSION_HOT] = sites.expansion
    for channel, level in nominal.noise.items():
        kind = Sensor.NOISE_RELATIVE if channel == RESISTANCE else Sensor.NOISE
        c[sensor_index(channel, kind)] = level
    alpha, beta, offset = population(
        domains, heating=nominal.heating, width=nominal.width, offset=nominal.offset
    )
    temperature = np.linspace(cold, hot, 2000)
    up = np.searchsorted(np.sort(alpha + offset), temperature, side="right") / domains
    down = np.searchsorted(np.sort(beta + offset), temperature, side="left") / domains
    path = list(zip(np.tile(temperature, 2), np.concatenate([up, down]), strict=True))

    def miss(unknown: np.ndarray) -> np.ndarray:
        c[Coefficient.CURVATURE], c[Coefficient.BENDING] = unknown
        tip = np.array([truth_deflection(c, t, s) for t, s in path])
        return np.array([tip.min(), tip.max()]) * 1e6 - np.array(nominal.deflection_extent) * 1e6

    # Newton's steps, here because `scipy.optimize` takes longer to load than a node may take to start
    found = np.array([nominal.deflection_extent[0], nominal.deflection_range]) * 2.0 / nominal.length**2
    for _ in range(_STEPS):
        left = miss(found)
        if np.max(np.abs(left)) < _NEAR_UM:
            break
        step = 1e-6 * np.max(np.abs(found))
        slopes = np.column_stack([(miss(found + step * one) - left) / step for one in np.eye(2)])
        if np.linalg.matrix_rank(slopes) < len(slopes):
            raise ValueError(
                f"device {nominal.id}: found no bending by a transition of {nominal.heating[0]:g} degC over the operating range, "
                f"{cold:.4g} to {hot:.4g} degC; need one that lies within, and length and range in m"
            )
        found = found - np.linalg.solve(slopes, left)
    else:
        raise ValueError(f"device {nominal.id}: found no bending that spans {nominal.deflection_extent} m")
    miss(found)
    return c
