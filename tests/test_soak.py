"""A long run in one process: no memory grows, and what is streamed is what is computed in one piece."""

import time
from pathlib import Path

import numpy as np
import pytest
from vo2_models.device import DeviceModel, chain
from vo2_models.device.coefficients import CHANNELS
from vo2_models.model_file import load_model_parameters
from vo2_models.recording import RESISTANCE
from vo2_models.self_sensing import self_sensing
from vo2_models.self_sensing.memory import StreamingMemory

_BLOCK = 10_000
_WARM_UP = 100_000
_MOST_MB = 5.0
_MOST_DRIFT = 1e-9


def resident_mb():
    """Memory of this process in use [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


@pytest.mark.parametrize("samples", [60_000, pytest.param(20_000_000, marks=pytest.mark.slow)])
def test_streaming_for_long_neither_grows_nor_drifts(samples, model_file, capsys):
    parameters = load_model_parameters(model_file)
    device = DeviceModel.from_parameters(parameters)
    stepper, whole = device.stepper(noise=False), device.simulation
    scheme = self_sensing("composite", parameters)
    memory = StreamingMemory(scheme, device.description.resistance_range)
    constants, state, remembered = (
        whole.prepared(stepper.period),
        whole.initial_state(),
        scheme.initial_state(),
    )
    out, silence = np.empty((_BLOCK, chain.COLUMNS)), np.zeros((_BLOCK, len(CHANNELS)))
    column = CHANNELS.index(RESISTANCE)
    low, high = device.description.operating_range
    rng, drift, before, began = np.random.default_rng(0), 0.0, 0.0, time.monotonic()
    warm_up = min(_WARM_UP, samples // 2)
    for done in range(0, samples, _BLOCK):
        if done == warm_up:
            before = resident_mb()
        currents = np.repeat(rng.uniform(low, high, _BLOCK // 20), 20)
        currents[:20], currents[20:40] = high, low
        streamed = np.empty((_BLOCK, 2))
        for k, current in enumerate(currents.tolist()):
            resistance = float(stepper.step(current)[column])
            streamed[k] = resistance, memory.step(resistance)[0]
        whole.call(constants, state, currents, silence, out)
        estimate, remembered = scheme.estimate(out[:, column], remembered)
        far = streamed - np.column_stack([out[:, column], np.asarray(estimate.deflection)])
        drift = max(drift, float(np.max(np.abs(far) / [1e5, 1e-4])))
    grown = resident_mb() - before
    with capsys.disabled():
        print(
            f"\nsoak: {samples} samples in {time.monotonic() - began:.0f} s, memory grew by {grown:.2f} MB after the first "
            f"{warm_up}, batch and stream apart by {drift:.1e} of the range"
        )
    assert memory.known
    assert drift <= _MOST_DRIFT
    assert grown < _MOST_MB
