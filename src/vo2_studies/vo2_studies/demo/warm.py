"""Compile the numerical kernels that the demo and the tests use into numba's cache, once after set-up."""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np
from vo2_control.closed_loop import run_loop
from vo2_control.designs import current_limits
from vo2_control.model_tuning import tuned_from_model
from vo2_control.pid import pid_controller
from vo2_models.device import truth
from vo2_models.device.description import preset
from vo2_models.diagnosis.breakdown import turning_points
from vo2_models.diagnosis.loop_shape import loop_shapes
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import RESISTANCE
from vo2_models.self_sensing import KINDS, self_sensing

__all__ = ["main"]


def main() -> int:
    """Run an identification, a few estimates and a corrected simulation on the smallest sensible recordings."""
    started = time.monotonic()
    share = damped_oscillation(np.linspace(0.0, 1.0, 13))
    current = np.repeat(3.68e-3 + 4.81e-3 * share, 10)
    device = truth("integrated", seed=1)
    stepper = device.stepper(seed=1)
    stepper.step(0.0)
    recording = device.simulate(current, seed=1)
    _, model = fit_model([recording], "integrated", plays=6)
    for kind in KINDS:
        self_sensing(kind, model).estimate(recording[RESISTANCE][:10])
    period, limits = preset("integrated").sample_period, current_limits("integrated", model)
    law = pid_controller(tuned_from_model(model, period, limits=limits).gains, limits, period)
    for kind in ("composite", "polynomial"):
        run_loop(device, self_sensing(kind, model), law, np.full(10, 30e-6))
    nominal = Nominal.from_parameters(model)
    shapes = {channel: shape.fold() for channel, shape in loop_shapes(nominal).items()}
    turning_points(replace(nominal, corrections=shapes).respond(current, period).temperature)
    print(f"[vo2] kernels ready after {time.monotonic() - started:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
