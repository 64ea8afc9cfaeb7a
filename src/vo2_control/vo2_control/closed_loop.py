"""Offline closed loop: simulated device, self-sensing and controller in one compiled loop, for studies of many devices.

Sample k: the device advances one period under the current decided before; its resistance is measured and turned
into an estimate; controller and feedforward decide the next current. The same laws as on the graph:
`limited_step` here is `vo2_control.controller.limited_step`, compiled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vo2_models.device import chain
from vo2_models.device.description import preset
from vo2_models.device.simulation import Simulation, white_noise
from vo2_models.numerics.kernel import kernel
from vo2_models.self_sensing.composite import CompositeSelfSensing, composite_step
from vo2_models.self_sensing.polynomial import PolynomialSelfSensing, polynomial_step
from vo2_models.self_sensing.scheme import SelfSensing
from vo2_models.validation import finite_array

from vo2_control.controller import LinearController, limited_step

__all__ = ["LoopResult", "run_loop"]

Floats = NDArray[np.float64]

_TRUTH, _POLYNOMIAL, _COMPOSITE = 0, 1, 2
_NOTHING = np.zeros(0)
_limited_step = kernel(limited_step)


def _packed(sensing: SelfSensing | None) -> tuple[int, Floats, Floats, Floats, Floats, Floats]:
    """Kind, the two laws, scales, error bounds and memory of a scheme, as the compiled loop takes them."""
    if sensing is None:
        return _TRUTH, _NOTHING, _NOTHING, _NOTHING, _NOTHING, _NOTHING
    if isinstance(sensing, PolynomialSelfSensing):
        return _POLYNOMIAL, sensing.domain, sensing.coefficients, _NOTHING, sensing.table, _NOTHING
    if isinstance(sensing, CompositeSelfSensing):
        thermal = sensing._thermal
        inverse, deflection = sensing._inverse.packed, sensing.deflection.packed
        return _COMPOSITE, inverse, deflection, thermal, sensing.table, sensing.initial_state()
    raise ValueError(
        f"sensing: found {type(sensing).__name__}, need polynomial or composite self-sensing, or None"
    )


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


@kernel
def _estimate(kind, first, second, scales, table, memory, resistance, truth):
    if kind == _POLYNOMIAL:
        return polynomial_step(resistance, first, second, table)[0]
    if kind == _COMPOSITE:
        return composite_step(resistance, first, second, scales, table, memory)[0]
    return truth


@kernel
def _run(
    kind, c, packed_r, packed_d, poly_r, poly_d, levels, domains,
    x, play_r, play_d, metallic, line,
    sensing, first, second, scales, table, memory,
    a, b, cc, d, conditioning, squared, lower, upper, most, state,
    reference, ahead, disturbance, normals, command, sample, out,
):  # fmt: skip
    # command (1,) and sample (1, COLUMNS) come from outside: the chain borrows its arrays, and the compiler would
    # take stores into one allocated here for dead
    current = state[-1]
    following = np.empty(state.size - 1)
    for k in range(reference.size):
        command[0] = current + disturbance[k]
        chain.run_chain(
            kind, c, packed_r, packed_d, poly_r, poly_d, levels, domains, x, play_r, play_d, metallic,
            line, command, normals[k : k + 1], command[:0], sample,
        )  # fmt: skip
        estimate = _estimate(sensing, first, second, scales, table, memory, sample[0, 1], sample[0, 4])
        out[k, 0] = estimate
        out[k, 1] = sample[0, 4]
        out[k, 2] = current
        out[k, 3] = sample[0, 5]
        current = _limited_step(
            a, b, cc, d, conditioning, squared, lower, upper, most, state, following, reference[k], estimate,
            ahead[k],
        )  # fmt: skip


def run_loop(
    device: Simulation,
    sensing: SelfSensing | None,
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
    sensing : self-sensing scheme, from its initial memory; None feeds the true deflection back, which leaves the
        controller's own error
    controller : its memory before the first sample is used and left as it is
    reference_m : (n,) [m]
    disturbance_a : (n,) added to the current behind the controller [A]; None for none
    feedforward_a : (n,) current that the feedback corrects, decided from the same sample on [A]; None for none
    dt : sample period [s], None for the preset's
    seed, noise : of the sensors' noise

    Returns
    -------
    LoopResult : all signals of the run

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
    c = device.prepared(period)
    memory = device.initial_state()
    law, limits = controller.law, controller.limits
    out = np.empty((reference.size, 4))
    _run(
        device.kind, c, device.packed_r, device.packed_d, device.poly_r, device.poly_d, device.levels,
        device.domains, memory.scalars, memory.play_r, memory.play_d, memory.metallic, memory.line,
        *_packed(sensing),
        law.a, law.b, law.c, law.d, law.conditioning, law.coordinate == "heating_power",
        limits.lower_a, limits.upper_a, limits.rate_a_per_s * period, controller.state,
        reference, ahead, disturbance, normals, np.empty(1), np.empty((1, chain.COLUMNS)), out,
    )  # fmt: skip
    return LoopResult(
        np.arange(float(reference.size)) * period, reference, *(out[:, k].copy() for k in range(4))
    )
