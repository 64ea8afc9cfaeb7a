"""The offline loop for any self-sensing scheme: what `vo2_control.closed_loop.run_loop` compiles, sample by sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_control.controller import LinearController
from vo2_models.device import TruthDevice
from vo2_models.recording import RESISTANCE
from vo2_models.self_sensing import SelfSensing

__all__ = ["streamed_errors"]

Floats = NDArray[np.float64]


def streamed_errors(
    device: TruthDevice,
    sensing: SelfSensing,
    controller: LinearController,
    reference_m: Floats,
    *,
    seed: int = 0,
) -> tuple[Floats, Floats]:
    """Return reference minus true and reference minus estimated deflection, (n,) [m] each, as `run_loop` from a long rest.

    `controller` starts from its present memory and is left as it is.
    """
    stepper = device.stepper(dt=controller.sample_period_s, seed=seed)
    film = stepper.channels.index(RESISTANCE)
    memory, before = sensing.initial_state(), controller.state
    current = float(before[-1])
    error, own = np.empty(reference_m.size), np.empty(reference_m.size)
    for k, wanted in enumerate(reference_m.tolist()):
        resistance = float(stepper.step(current)[film])
        estimate = sensing.step(resistance, memory)[0]
        error[k], own[k] = wanted - stepper.true_deflection, wanted - estimate
        current = controller.update(wanted, float(estimate))
    controller.state = before
    return error, own
