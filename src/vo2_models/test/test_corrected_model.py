"""The corrected model as it is written: what it leaves by itself, and on a recording that nobody fitted."""

import numpy as np
import pytest
from vo2_models.device.description import described
from vo2_models.device.model import DeviceModel
from vo2_models.diagnosis.corrected_model import corrected_model
from vo2_models.diagnosis.pipeline import study
from vo2_models.identification.model_fit import fit_model
from vo2_models.prediction import predict
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

DT, INNER = 0.05, 10
WIRE = {
    "schema": "vo2-device/1",
    "id": "wire_of_test",
    "drive": {"channel": "wire_current", "unit": "A", "limits": [0.0, 0.4]},
    "body": {
        "kind": "first_order",
        "ambient": 23.0,
        "power_gain": 80.0,
        "time_constant": 2.0,
        "dead_time": 0.0,
    },
    "responses": {
        "film_resistance": {"unit": "ohm", "scale": "log10", "range": [8.0, 10.2], "noise": 5e-4},
        "tip_deflection": {"unit": "m", "range": [0.0, 4.1e-3], "noise": 5e-6},
    },
    "sampling": {"period": DT},
}


def wire(current: np.ndarray, *, loss: float = 1.0, seed: int = 0) -> Recording:
    """A wire that its current heats through its own resistance, and that contracts: relays over temperature."""
    rng = np.random.default_rng(3)
    middle, half = rng.normal(72.0, 7.0, 2000), np.clip(rng.normal(10.0, 3.0, 2000), 0.5, None)
    conductance, capacity = 12.8e-3 * loss, 12.8e-3 * 2.0
    state, temperature = np.zeros(2000), 23.0
    resistance, stroke = np.empty(current.size), np.empty(current.size)
    for k, i in enumerate(current):
        for _ in range(INNER):
            changed = state.mean()
            ohm = (10.0 - 2.0 * changed) * (1.0 + 2e-4 * (temperature - 23.0))
            temperature += DT / INNER * (i * i * ohm - conductance * (temperature - 23.0)) / capacity
            state[temperature >= middle + half] = 1.0
            state[temperature <= middle - half] = 0.0
        resistance[k] = (10.0 - 2.0 * state.mean()) * (1.0 + 2e-4 * (temperature - 23.0))
        stroke[k] = 4e-3 * state.mean()
    noise = np.random.default_rng(seed)
    return Recording(
        DT * np.arange(current.size),
        {
            HEATER_CURRENT: current,
            RESISTANCE: resistance + 4e-3 * noise.normal(size=current.size),
            TIP_DEFLECTION: stroke + 4e-6 * noise.normal(size=current.size),
        },
        described(WIRE, "wire").key,
    )


def steps(seed: int, count: int = 30) -> np.ndarray:
    """Current [A] that is held for 5 s at random levels, from cold."""
    levels = np.random.default_rng(seed).uniform(0.0, 0.4, count)
    return np.r_[np.zeros(100), np.repeat(levels, 100)]


@pytest.mark.slow
def test_loops_that_the_answer_lets_change_are_in_the_file_and_hold_on_another_recording():
    parameters = fit_model([wire(steps(1, 60), seed=1)], described(WIRE, "wire").key)[1]
    found = study([wire(steps(2), loss=1.15, seed=2)], parameters)
    assert found.verdict != "agrees"
    written = corrected_model(found)
    assert max(written.nrmse.values()) < 0.01
    before, after = (
        predict(DeviceModel.from_parameters(model), wire(steps(3), loss=1.15, seed=3)).channels[
            TIP_DEFLECTION
        ]
        for model in (parameters, written.parameters)
    )
    assert before.error > 0.1 * before.span
    assert after.error < 0.01 * after.span
