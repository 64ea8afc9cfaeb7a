"""Compile the numerical kernels that the demo and the tests use into numba's cache, once after set-up."""

from __future__ import annotations

import sys
import time

import numpy as np
from vo2_models.device import truth
from vo2_models.excitation import damped_oscillation
from vo2_models.recording import RESISTANCE
from vo2_models.self_sensing import KINDS, identify, self_sensing

__all__ = ["main"]


def main() -> int:
    """Run a short identification and a few estimates on each preset's smallest sensible recording."""
    started = time.monotonic()
    share = damped_oscillation(np.linspace(0.0, 1.0, 13))
    current = np.repeat(3.68e-3 + 4.81e-3 * share, 10)
    device = truth("integrated", seed=1)
    stepper = device.stepper(seed=1)
    stepper.step(0.0)
    recording = device.simulate(current, seed=1)
    model = identify(recording, "integrated")
    for kind in KINDS:
        self_sensing(kind, model).estimate(recording[RESISTANCE][:10])
    print(f"[vo2] kernels ready after {time.monotonic() - started:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
