"""The two devices of the contract, as published numbers; everything else is derived from them."""

from __future__ import annotations

from dataclasses import dataclass, field

from vo2_models.recording import HEATER_CURRENT, RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

__all__ = ["PRESETS", "SAFE_CURRENT", "Preset", "preset"]

SAFE_CURRENT = 0.0
"""Current [A] a loop goes to when it loses its input; on both presets."""


@dataclass(frozen=True)
class Preset:
    """Published description of a device; nothing in it is fitted.

    Attributes
    ----------
    id : name in `header.frame_id` and `model.device`
    current_range, operating_range : [A]; the operating range runs from its coldest to its hottest current
    ambient : [degC]
    linear_gain, square_gain : steady temperature rise per current [K/A] and per squared current [K/A^2]
    time_constant, dead_time : of the heated body [s]
    resistance_range : lowest and highest over the operating range [ohm]
    deflection_extent : lowest and highest tip deflection over the operating range [m]
    deflection_range : what "per cent of range" divides by [m]
    heating, width, offset : mean and standard deviation over the material of the metallic transition on heating
        [degC, K], the loop width [K], the structural minus the metallic transition [K]
    noise : one standard deviation: relative for the resistance, [m] for the deflection, [K] for the temperature
    sample_period, shortest_period : [s]
    measures_temperature : whether `stage_temperature` is measured
    activation : activation energy of the insulating phase over Boltzmann's constant [K]
    metal_slope : decades of resistance the metallic phase loses per kelvin [1/K]
    threshold : percolation threshold of the metallic phase
    expansion : curvature lost per kelvin in the insulating and the metallic phase [1/(m K)], k_0 and k_1 of (5.7)
    length : of the cantilever [m]
    """

    id: str
    current_range: tuple[float, float]
    operating_range: tuple[float, float]
    ambient: float
    linear_gain: float
    square_gain: float
    time_constant: float
    dead_time: float
    resistance_range: tuple[float, float]
    deflection_extent: tuple[float, float]
    deflection_range: float
    heating: tuple[float, float]
    width: tuple[float, float]
    offset: tuple[float, float]
    noise: dict[str, float] = field(hash=False)
    sample_period: float
    shortest_period: float
    measures_temperature: bool
    activation: float
    metal_slope: float
    threshold: float
    expansion: tuple[float, float]
    length: float

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the measured channels."""
        measured = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)
        return (*measured, STAGE_TEMPERATURE) if self.measures_temperature else measured

    def steady_temperature(self, current: float) -> float:
        """Temperature [degC] the nominal thermal model settles to at the current [A]."""
        return self.ambient + self.linear_gain * current + self.square_gain * current * current


PRESETS = {
    # Chapter 7: 425 um SiO2 cantilever with VO2 inside and a metal heater on top. The expansion slopes keep
    # the ratio that section 5.3.2 found (2.8 to 4.3) and a magnitude that makes the branches visibly non-monotonic.
    "integrated": Preset(
        id="integrated",
        current_range=(0.0, 12.78e-3),
        operating_range=(3.68e-3, 8.49e-3),
        ambient=22.0,
        linear_gain=0.0,
        square_gain=1.01e6,
        time_constant=1.8e-3,
        dead_time=0.0,
        resistance_range=(11.19e3, 231.75e3),
        deflection_extent=(1.62e-6, 58.65e-6),
        deflection_range=57.03e-6,
        heating=(62.0, 3.5),
        width=(7.0, 2.0),
        offset=(0.8, 1.8),
        noise={RESISTANCE: 2e-3, TIP_DEFLECTION: 0.05e-6},
        sample_period=1e-3,
        shortest_period=50e-6,
        measures_temperature=False,
        activation=1740.0,
        metal_slope=3e-3,
        threshold=0.45,
        expansion=(1.4, 2.15),
        length=425e-6,
    ),
    # Chapters 5, 6 and 8: 300 um Si cantilever, VO2 film on a Peltier stage; expansion slopes of section 5.3.2.
    "peltier": Preset(
        id="peltier",
        current_range=(-1.2, 1.2),
        operating_range=(0.05, -1.15),
        ambient=25.0,
        linear_gain=-50.0,
        square_gain=0.0,
        time_constant=25.0,
        dead_time=0.375,
        resistance_range=(1.2e3, 120e3),
        deflection_extent=(0.0, 70e-6),
        deflection_range=70e-6,
        heating=(64.0, 2.5),
        width=(7.0, 1.8),
        offset=(0.7, 1.4),
        noise={RESISTANCE: 3e-3, TIP_DEFLECTION: 0.08e-6, STAGE_TEMPERATURE: 0.05},
        sample_period=0.125,
        shortest_period=1e-3,
        measures_temperature=True,
        activation=2320.0,
        metal_slope=4e-3,
        threshold=0.42,
        expansion=(2.8, 4.3),
        length=300e-6,
    ),
}
"""Device presets by id. Activation 0.15 and 0.20 eV; published films lie between 0.1 and 0.3 eV."""


def preset(name: str) -> Preset:
    """Return the preset; raise a `ValueError` that lists the known ones."""
    if name not in PRESETS:
        raise ValueError(f"device: found {name!r}, need one of {', '.join(PRESETS)}")
    return PRESETS[name]
