"""Offline closed loop: simulated device, self-sensing and controller in one compiled loop, for studies of many devices.

Sample k: the device advances one period under the current decided before; its resistance is measured and turned
into an estimate; controller and feedforward decide the next current. The same laws as on the graph:
`limited_step` here is `vo2_control.controller.limited_step`, compiled.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from vo2_models.device import chain
from vo2_models.device.presets import preset
from vo2_models.device.simulation import Simulation, white_noise
from vo2_models.hysteresis.inverse_kernels import invert_step
from vo2_models.hysteresis.kernels import egpi_step
from vo2_models.hysteresis.prandtl_ishlinskii import PlayModel
from vo2_models.validation import finite_array

from vo2_control.controller import LinearController, limited_step

__all__ = [
    "LoopResult",
    "Sensing",
    "composite_sensing",
    "polynomial_sensing",
    "run_loop",
    "true_deflection_sensing",
]

Floats = NDArray[np.float64]

_TRUTH, _POLYNOMIAL, _COMPOSITE = 0, 1, 2
_limited_step = njit(cache=True, error_model="numpy")(limited_step)


@dataclass(frozen=True)
class Sensing:
    """How the loop estimates deflection; make it with one of the functions below.

    Attributes
    ----------
    kind : which estimator
    numbers : its parameters: polynomial in the scaled log10 of the resistance, or the packed inverse model
    deflection : packed deflection model (composite)
    state_r, state_d : memories to start from (composite)
    """

    kind: int
    numbers: Floats = field(default_factory=lambda: np.zeros(1))
    deflection: Floats = field(default_factory=lambda: np.zeros(7))
    state_r: Floats = field(default_factory=lambda: np.zeros(1))
    state_d: Floats = field(default_factory=lambda: np.zeros(1))


def true_deflection_sensing() -> Sensing:
    """The true deflection itself: what is left is the controller's own error."""
    return Sensing(_TRUTH)


def polynomial_sensing(resistance_ohm: ArrayLike, deflection_m: ArrayLike, degree: int = 9) -> Sensing:
    """Deflection as a polynomial of log10 R (section 8.2), fitted by least squares; outside the fitted range clipped.

    Parameters
    ----------
    resistance_ohm, deflection_m : (n,) a calibration through both branches
    degree : 9 in section 8.2, 8 in section 7.3

    Raises
    ------
    ValueError : fewer samples than coefficients, a resistance that is not positive.
    """
    resistance = finite_array(resistance_ohm, "resistance_ohm")
    deflection = finite_array(deflection_m, "deflection_m", size=resistance.size)
    if resistance.size <= degree or np.any(resistance <= 0):
        raise ValueError(
            f"resistance_ohm: found {resistance.size} samples, need more than {degree} positive ones"
        )
    z = np.log10(resistance)
    centre, half = 0.5 * (z.max() + z.min()), 0.5 * (z.max() - z.min())
    fit = np.polynomial.Polynomial.fit((z - centre) / half, deflection, degree, domain=[-1, 1])
    return Sensing(_POLYNOMIAL, np.concatenate([[centre, half], fit.coef]))


def composite_sensing(inverse: Floats, state_r: Floats, deflection: PlayModel, state_d: Floats) -> Sensing:
    """Inverse resistance model to temperature, deflection model from there (section 7.2).

    Parameters
    ----------
    inverse : packed inverse of the model of -log10 R over temperature, as `hysteresis.inverse_kernels` has it
    state_r, state_d : memories of the two models
    deflection : model of deflection [m] over temperature [degC]
    """
    return Sensing(_COMPOSITE, inverse, deflection.packed, state_r, state_d)


@dataclass(frozen=True)
class LoopResult:
    """What happened, (n,) each: reference, estimate and true deflection [m], commanded current [A], temperature [degC]."""

    time_s: Floats
    reference_m: Floats
    estimate_m: Floats
    deflection_m: Floats
    current_a: Floats
    temperature_degc: Floats

    def after(self, count: int) -> LoopResult:
        """The samples from `count` on."""
        return LoopResult(*(getattr(self, name)[count:] for name in self.__dataclass_fields__))

    @property
    def error_m(self) -> Floats:
        """Reference minus true deflection [m]."""
        return self.reference_m - self.deflection_m


@njit(cache=True, error_model="numpy")
def _estimate(kind, numbers, deflection, state_r, state_d, resistance, truth):
    if kind == _TRUTH:
        return truth
    if kind == _POLYNOMIAL:
        z = (np.log10(resistance) - numbers[0]) / numbers[1]
        z = min(max(z, -1.0), 1.0)
        value = 0.0
        for k in range(numbers.size - 1, 1, -1):
            value = value * z + numbers[k]
        return value
    temperature, _ = invert_step(-np.log10(resistance), numbers, state_r)
    return egpi_step(temperature, deflection, state_d)


@njit(cache=True, error_model="numpy")
def _run(
    kind, c, mode, packed_r, packed_d, poly_r, poly_d, levels, domains,
    x, play_r, play_d, metallic, line, sensors, sensor_lines,
    sensing, numbers, deflection, state_r, state_d,
    a, b, cc, d, conditioning, squared, lower, upper, most, state,
    reference, ahead, disturbance, normals, out,
):  # fmt: skip
    command = np.empty(1)
    sample = np.empty((1, chain.COLUMNS))
    current = state[-1]
    for k in range(reference.size):
        command[0] = current + disturbance[k]
        chain.run_chain(
            kind, c, mode, packed_r, packed_d, poly_r, poly_d, levels, domains, x, play_r, play_d, metallic,
            line, sensors, sensor_lines, command, normals[k : k + 1], sample,
        )  # fmt: skip
        estimate = _estimate(sensing, numbers, deflection, state_r, state_d, sample[0, 1], sample[0, 4])
        out[k, 0] = estimate
        out[k, 1] = sample[0, 4]
        out[k, 2] = current
        out[k, 3] = sample[0, 5]
        current = _limited_step(
            a, b, cc, d, conditioning, squared, lower, upper, most, state, reference[k], estimate, ahead[k]
        )


def run_loop(
    device: Simulation,
    sensing: Sensing,
    controller: LinearController,
    reference_m: ArrayLike,
    *,
    disturbance_a: ArrayLike | None = None,
    feedforward_a: ArrayLike | None = None,
    dt: float | None = None,
    seed: int = 0,
    noise: bool = True,
) -> LoopResult:
    """Run one experiment from the device's long rest.

    Parameters
    ----------
    device : simulated device
    sensing : estimator
    controller : its memory before the first sample is used and left as it is
    reference_m : (n,) [m]
    disturbance_a : (n,) added to the current behind the controller [A]; None for none
    feedforward_a : (n,) current that the feedback corrects, decided from the same sample on [A]; None for none
    dt : sample period [s], None for the preset's
    seed, noise : of the sensors' noise

    Raises
    ------
    ValueError : sample periods of controller and experiment differ, a reference that is not finite.
    """
    reference = finite_array(reference_m, "reference_m")
    period = preset(device.device).sample_period if dt is None else dt
    if abs(controller.sample_period_s - period) > 1e-9 * period:
        raise ValueError(f"controller: found a period of {controller.sample_period_s:g} s, need {period:g} s")
    disturbance = np.zeros(reference.size)
    if disturbance_a is not None:
        disturbance = finite_array(disturbance_a, "disturbance_a", size=reference.size)
    ahead = np.full(reference.size, controller.law.operating_a)
    if feedforward_a is not None:
        ahead += finite_array(feedforward_a, "feedforward_a", size=reference.size)
    normals = white_noise(seed, reference.size) if noise else np.zeros((reference.size, 4))
    c, mode = device.prepared(period)
    memory = device.initial_state()
    law, limits = controller.law, controller.limits
    out = np.empty((reference.size, 4))
    _run(
        device.kind, c, mode, device.packed_r, device.packed_d, device.poly_r, device.poly_d, device.levels,
        device.domains, memory.scalars, memory.play_r, memory.play_d, memory.metallic, memory.line,
        memory.sensors, memory.sensor_lines,
        sensing.kind, sensing.numbers, sensing.deflection, sensing.state_r.copy(), sensing.state_d.copy(),
        law.a, law.b, law.c, law.d, law.conditioning, law.coordinate == "heating_power",
        limits.lower_a, limits.upper_a, limits.rate_a_per_s * period, controller.state,
        reference, ahead, disturbance, normals, out,
    )  # fmt: skip
    return LoopResult(
        np.arange(float(reference.size)) * period, reference, *(out[:, k].copy() for k in range(4))
    )
