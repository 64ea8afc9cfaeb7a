"""Compile the numerical kernels that the demo and the tests use into numba's cache, once after set-up."""

from __future__ import annotations

import multiprocessing
import sys
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from vo2_control.closed_loop import run_loop
from vo2_control.designs import current_limits
from vo2_control.model_tuning import tuned_from_model
from vo2_control.pid import pid_controller
from vo2_models.device import DeviceModel, truth
from vo2_models.device.description import described, preset
from vo2_models.diagnosis.breakdown import turning_points
from vo2_models.diagnosis.loop_shape import loop_shapes
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.hysteresis.laws.bounded_plays import EXAMPLE
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing import KINDS, self_sensing
from vo2_models.self_sensing.characterisation import characterise

from vo2_studies.published_models import chapter_7_tables

__all__ = ["main"]

_DEVICE = "integrated"


def _current() -> NDArray[np.float64]:
    share = damped_oscillation(np.linspace(0.0, 1.0, 13))
    return np.repeat(3.68e-3 + 4.81e-3 * share, 10)


def _made_up() -> Recording:
    """Return a recording of two logistic branches, which needs no compiled simulation."""
    current = _current()
    center = np.where(np.gradient(current) >= 0.0, 65.0, 59.0)
    warm = 1.0 / (1.0 + np.exp(-(22.0 + 1.0e6 * current**2 - center) / 2.0))
    noise = np.random.default_rng(1).normal(size=(2, current.size))
    channels = {
        HEATER_CURRENT: current,
        RESISTANCE: 10.0 ** (5.3 - 1.2 * warm + 2e-3 * noise[0]),
        TIP_DEFLECTION: 5e-5 * warm + 1e-6 + 5e-8 * noise[1],
    }
    return Recording(
        preset(_DEVICE).sample_period * np.arange(current.size, dtype=np.float64), channels, _DEVICE
    )


def _estimation() -> None:
    """Identify and use every scheme of self-sensing."""
    recording, known = _made_up(), chapter_7_tables().parameters
    model = {**known, **characterise(recording, known)}
    for kind in KINDS:
        self_sensing(kind, model, judged=False).estimate(recording[RESISTANCE][:10])


def _another_law() -> None:
    """Simulate a device whose law is no bank of plays, as a diagnosis does: the chain is compiled anew for it."""
    rig = described(
        {
            "schema": "vo2-device/1",
            "id": "rig",
            "drive": {"channel": "volts", "unit": "V", "limits": [0.0, 4.0]},
            "responses": {"travel": {"unit": "m"}},
        },
        "rig",
    )
    Nominal(DeviceModel(rig.key, deflection=EXAMPLE), {}, None, {}).respond(np.ones(10), 0.1, settled=True)


def main() -> int:
    """Run an identification, a few estimates and a corrected simulation on the smallest sensible recordings."""
    started = time.monotonic()
    # a process of its own compiles self-sensing beside the simulation; what it has compiled is loaded below
    beside = multiprocessing.get_context("fork").Process(target=_estimation, daemon=True)
    beside.start()
    current, period = _current(), preset(_DEVICE).sample_period
    device = truth(_DEVICE, seed=1)
    stepper = device.stepper(seed=1)
    stepper.step(0.0)
    recording = device.simulate(current, seed=1)
    fit_model([recording], _DEVICE, plays=6, self_sensing=False)
    beside.join()
    beside = multiprocessing.get_context("fork").Process(target=_another_law, daemon=True)
    beside.start()
    _, model = fit_model([recording], _DEVICE, plays=6)
    for kind in KINDS:
        self_sensing(kind, model, judged=False).estimate(recording[RESISTANCE][:10])
    limits = current_limits(_DEVICE, model)
    law = pid_controller(tuned_from_model(model, period, limits=limits).gains, limits, period)
    for kind in ("composite", "polynomial"):
        run_loop(device, self_sensing(kind, model), law, np.full(10, 30e-6))
    nominal = Nominal.from_parameters(model)
    shapes = {channel: shape.fold() for channel, shape in loop_shapes(nominal).items()}
    turning_points(replace(nominal, corrections=shapes).respond(current, period).temperature)
    beside.join()
    print(f"[vo2] kernels ready after {time.monotonic() - started:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
