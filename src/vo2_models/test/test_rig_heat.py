"""Whether the drive of a film heats it: the compiled chain against the equations, and what a fit chooses."""

import numpy as np
import pytest
from vo2_models.device.description import described
from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import BankShape
from vo2_models.identification.model_fit import fit_model
from vo2_models.prediction import predict
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, Recording

DT, FINE = 1e-3, 10
HEIGHTS = (2.2, 2.7, 3.3)


def _device(unit: str = "V"):
    return described(
        {
            "schema": "vo2-device/1",
            "id": "film_3",
            "drive": {"channel": f"drive_{unit}", "unit": unit, "limits": [0.0, 4.0]},
            "responses": {"film_resistance": {"unit": "ohm"}},
        },
        "film",
    )


def _laws(level: float = -3.0) -> PlayBank:
    shape = BankShape(
        np.log([0.2, 0.3]),
        np.array([50.0, 60.0]),
        np.log([3.0, 5.0]),
        np.log([0.2, 0.3]),
        np.array([level, 0.0]),
    )
    return shape.bank()


def _model(unit: str, **scalars: float) -> DeviceModel:
    named = {f"thermal.{name}": value for name, value in scalars.items()}
    cold = {"thermal.ambient": 30.0, "thermal.linear_gain": 0.0}
    return DeviceModel(_device(unit).key, scalars={**cold, **named}, resistance=_laws())


@pytest.mark.parametrize("unit", ["V", "A"])
def test_the_chain_heats_the_film_by_its_own_resistance_through_two_lags(unit):
    model = _model(
        unit,
        power_gain=1e-2 if unit == "A" else 5e4,
        time_constant=0.05,
        slow_share=0.3,
        slow_time_constant=0.4,
    )
    drive = np.repeat([1.0, 1.6, 0.3], 400)
    run = model.simulate(drive, dt=DT, noise=False)
    rest = model.simulate(np.zeros(1), dt=DT, noise=False)[RESISTANCE][0]
    before = np.r_[rest, run[RESISTANCE][:-1]]
    power = drive**2 / before if unit == "V" else drive**2 * before
    fast = slow = 0.0
    expected = np.empty(drive.size)
    for k, p in enumerate(model.scalars["thermal.power_gain"] * power):
        fast += (p - fast) * -np.expm1(-DT / 0.05)
        slow += (p - slow) * -np.expm1(-DT / 0.4)
        expected[k] = 30.0 + 0.7 * fast + 0.3 * slow
    assert run["true_temperature"] == pytest.approx(expected, abs=1e-6)
    assert np.ptp(np.log10(run[RESISTANCE])) > 0.2  # it did switch


def test_neutral_scalars_change_nothing_and_are_not_written():
    plain, parameters = _model("V", linear_gain=10.0), _model("V", linear_gain=10.0).to_parameters()
    assert not any("power_gain" in name or "slow" in name for name in parameters)
    named = _model("V", linear_gain=10.0, power_gain=0.0, slow_share=0.0)
    drive = np.linspace(0.0, 4.0, 200)
    assert np.array_equal(plain.simulate(drive, dt=DT)[RESISTANCE], named.simulate(drive, dt=DT)[RESISTANCE])
    heated = _model("V", power_gain=1e4, slow_share=0.2, slow_time_constant=0.3)
    again = DeviceModel.from_parameters(heated.to_parameters())
    assert again.scalars == heated.scalars
    assert heated.heats and not plain.heats


def test_settled_at_a_drive_is_where_holding_it_leads():
    model = _model("V", power_gain=5e4, time_constant=0.02, slow_share=0.3, slow_time_constant=0.2)
    held = model.simulate(np.full(5000, 1.3), dt=DT, noise=False)
    at_once = model.simulate(np.full(3, 1.3), dt=DT, noise=False, settled=True)
    assert at_once["true_temperature"][0] == pytest.approx(held["true_temperature"][-1], abs=1e-3)


def _film(drive: np.ndarray, heat: str, *, share: float = 0.0, seed: int = 0) -> np.ndarray:
    """Resistance of a film of 400 domains that switch at temperatures of their own, by small Euler steps."""
    rng = np.random.default_rng(5)
    up = rng.normal(45.0, 4.0, 400)
    down = up - rng.uniform(3.0, 9.0, 400)
    metal, resistance, out = np.zeros(400, dtype=bool), 1000.0, np.empty(drive.size)
    rise = {
        "film": lambda v, r: 1.6e3 * v * v / r,
        "heater": lambda v, r: 2.4 * v * v,
        "none": lambda v, r: 8.0 * v,
    }[heat]
    fast = slow = rise(drive[0], resistance) if heat == "none" else 0.0
    for k, v in enumerate(drive):
        for _ in range(FINE):
            target = rise(v, resistance)
            fast += (target - fast) * DT / FINE / 0.004
            slow += (target - slow) * DT / FINE / 0.06
            temperature = 28.0 + (1.0 - share) * fast + share * slow
            metal = (metal & (temperature > down)) | (temperature > up)
            resistance = 1000.0 * 10.0 ** (-0.4 * metal.mean() - 0.002 * (temperature - 28.0))
        out[k] = resistance
    return out * np.exp(np.random.default_rng(seed).normal(0.0, 0.001, out.size))


def _pulse(height: float) -> np.ndarray:
    return np.concatenate(
        [np.full(160, height), np.full(120, 0.4), np.full(60, 0.8 * height), np.full(60, 0.4)]
    )


def _recording(height: float, heat: str, share: float) -> Recording:
    drive = _pulse(height)
    ohm = _film(drive, heat, share=share, seed=round(10 * height))
    return Recording(DT * np.arange(drive.size), {HEATER_CURRENT: drive, RESISTANCE: ohm}, "film_3")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("heat", "share"), [("film", 0.4), ("none", 0.4), ("heater", 0.4), ("none", 0.0), ("film", 0.0)]
)
def test_own_heat_is_found_where_it_is_and_not_where_it_is_not(heat, share):
    """Pulses of three heights calibrate, one between them is predicted."""
    recordings = [_recording(height, heat, share) for height in HEIGHTS]
    result, _ = fit_model(recordings, _device().key)
    scalars, notes = result.model.scalars, " ".join(result.notes)
    assert (scalars["thermal.power_gain"] > 0.0) == (heat == "film")
    assert ("its own heater, by V^2/R" in notes) == (heat == "film")
    if heat == "film":
        assert result.model.heats and not result.settled
    found = predict(result.model, _recording(2.45, heat, share)).channels[RESISTANCE]
    calibrated = np.log10(np.concatenate([recording[RESISTANCE] for recording in recordings]))
    assert found.error < 0.03 * np.ptp(calibrated)  # the pulse itself may hardly switch
    if heat != "none":
        assert found.inside > 0.9
