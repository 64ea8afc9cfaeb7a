"""A body that is heated by the power in the resistance that is measured: a wire, or a film, that is its own heater."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from vo2_models.device.description import preset
from vo2_models.device.model import DeviceModel
from vo2_models.recording import Recording
from vo2_models.workflow import fit, simulate

Floats = NDArray[np.float64]
DT, TAU, AMBIENT, GAIN = 0.02, 0.6, 24.0, 108.0
"""Sample period [s], time constant [s], room [degC], K/W."""
NOISE = {"wire_resistance": 1e-3, "contraction": 4e-6}
"""Relative, and in metre."""
HIGHEST = 0.6  # A, or V over about 2 ohm


def wire(drive: Floats, *, volt: bool, seed: int) -> Recording:
    """Solve tau dT/dt = T0 + g P - T in steps of 2 ms, P = I^2 R or V^2/R, with 400 switching domains."""
    rng = np.random.default_rng(0)
    up = rng.normal(70.0, 5.0, 400)
    down = up - np.maximum(rng.normal(12.0, 3.0, 400), 2.0)
    on, share, temperature, resistance = np.zeros(400, bool), 0.0, AMBIENT, 2.0
    gain = GAIN * 4.0 if volt else GAIN
    values = np.empty((2, drive.size))
    for k, now in enumerate(drive):
        for _ in range(10):
            power = now**2 / resistance if volt else now**2 * resistance
            temperature += 0.1 * DT / TAU * (AMBIENT + gain * power - temperature)
            on = np.where(temperature > up, True, np.where(temperature < down, False, on))
            share = float(on.mean())
            resistance = 2.0 * (1.0 + 2e-4 * (temperature - AMBIENT) - 0.16 * share)
        values[:, k] = resistance, 4e-3 * share - 1e-6 * (temperature - AMBIENT)
    noise = np.random.default_rng(seed).standard_normal((2, drive.size))
    names = list(NOISE)
    channels = {
        "source": drive,
        names[0]: values[0] * (1.0 + NOISE[names[0]] * noise[0]),
        names[1]: values[1] + NOISE[names[1]] * noise[1],
    }
    return Recording(time_s=DT * np.arange(drive.size), channels=channels, device="wire")


def loops() -> Floats:
    """Smaller and smaller loops, then steps."""
    count = int(7 * TAU / DT)
    ramps = [
        np.r_[np.linspace(0.3, 0.3 + 0.75 * size, count), np.linspace(0.3 + 0.75 * size, 0.45, count)]
        for size in np.linspace(1.0, 0.4, 7)
    ]
    steps = np.repeat(np.random.default_rng(3).uniform(0.3, 1.05, 25), int(1.5 * TAU / DT))
    return HIGHEST * np.concatenate([*ramps, steps])


def file_of(folder, unit: str, body: dict) -> str:
    """Write a device file and return its path."""
    path = folder / f"wire_{unit}_{'_'.join(body)}.yaml"
    document = {
        "schema": "vo2-device/1",
        "id": "wire",
        "drive": {"channel": "source", "unit": unit, "limits": [0.0, 0.7], "operating": [0.18, 0.63]},
        "body": {"kind": "first_order", "ambient": AMBIENT, "time_constant": 0.4, **body},
        "responses": {
            "wire_resistance": {"unit": "ohm", "scale": "log10"},
            "contraction": {"unit": "m"},
        },
    }
    path.write_text(yaml.safe_dump(document))
    return str(path)


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(
    ("unit", "gain"), [("A", GAIN), pytest.param("V", 4.0 * GAIN, marks=pytest.mark.slow)]
)
def test_the_power_in_the_wire_is_what_heats_it(tmp_path, unit, gain):
    volt = unit == "V"
    calibration = wire(loops(), volt=volt, seed=1)
    model = fit(calibration, file_of(tmp_path, unit, {"power_gain": gain}))
    assert model["model.thermal.time_constant"] == pytest.approx(TAU, rel=0.02)
    assert model["model.thermal.power_gain"] == pytest.approx(gain)
    assert model["model.thermal.square_gain"] == 0.0

    # a free run, in which the model's own resistance makes the heat, of another recording
    levels = HIGHEST * np.repeat(np.random.default_rng(7).uniform(0.3, 1.05, 40), int(TAU / DT))
    later = wire(levels, volt=volt, seed=2)
    free = simulate(model, levels, dt=DT, noise=False)
    own = float(np.sqrt(np.mean((free["contraction"] - later["contraction"]) ** 2)))
    plain = fit(calibration, file_of(tmp_path, unit, {"square_gain": 90.0 / HIGHEST**2}))
    constant = simulate(plain, levels, dt=DT, noise=False)
    missed = float(np.sqrt(np.mean((constant["contraction"] - later["contraction"]) ** 2)))
    print(f"{unit}: {1e6 * own:.1f} um, with a constant resistance {1e6 * missed:.1f} um")
    assert own < 0.4 * missed


def test_what_the_file_tells_is_what_the_model_starts_from(tmp_path):
    own = preset(file_of(tmp_path, "A", {"power_gain": GAIN}))
    scalars = DeviceModel(own.key).scalars
    assert scalars["thermal.power_gain"] == GAIN
    assert scalars["thermal.square_gain"] == 0.0
    # without a range in the file a resistance lies between 1 and 10 ohm
    assert own.steady_temperature(0.5) == pytest.approx(AMBIENT + GAIN * 0.25 * np.sqrt(10.0))


@pytest.mark.parametrize(
    ("unit", "body", "said"),
    [
        ("A", {"power_gain": 100.0, "square_gain": 5.0}, "found square_gain beside it, need one of them"),
        ("N", {"power_gain": 100.0}, "found a drive in 'N', need A or V"),
        ("A", {"power_gain": 0.0}, "power_gain: found 0.0, need a finite number above 0"),
    ],
)
def test_a_power_that_cannot_be_is_told(tmp_path, unit, body, said):
    with pytest.raises(ValueError, match=said):
        preset(file_of(tmp_path, unit, body))


def test_a_recording_without_the_resistance_cannot_tell_the_power(tmp_path):
    whole = wire(loops()[:700], volt=False, seed=1)
    blind = Recording(
        time_s=whole.time_s, channels={name: whole[name] for name in ("source", "contraction")}, device="wire"
    )
    with pytest.raises(ValueError, match="found one without wire_resistance, need it in each"):
        fit(blind, file_of(tmp_path, "A", {"power_gain": GAIN}))


def test_the_library_takes_the_channels_of_the_device_file_and_gives_them_back(tmp_path):
    own = preset(file_of(tmp_path, "A", {"power_gain": GAIN}))
    recording = wire(loops()[:100], volt=False, seed=1)
    roles = own.understood(recording)
    assert set(roles.channels) == {"heater_current", "film_resistance", "tip_deflection"}
    assert own.understood(roles) == roles
    assert set(own.in_channels(roles).channels) == set(recording.channels)
