"""Laws over the drive: found again from a synthetic device, and blind where they should be."""

import numpy as np
import pytest
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.drive_fit import fit_drive, held_out
from vo2_models.recording import Recording


def rig(channel="tip_deflection", count=1200):
    bank = PlayBank(
        weights=[3e-6, 5e-6],
        radii=[0.0, 0.3],
        rising_slopes=[0.5, 0.5],
        rising_offsets=[-1.6, -1.6],
        falling_slopes=[0.5, 0.5],
        falling_offsets=[-1.2, -1.2],
        polynomial=[1e-6, 2e-7],
    )
    time = np.arange(count) / 100.0
    drive = 2.5 - 2.5 * np.cos(time * 2.0) * (0.4 + 0.6 * np.cos(time * 0.13) ** 2)
    output, _ = bank.egpi().simulate(drive)
    if channel == "film_resistance":
        output = 10.0 ** -(output * 1e5 - 4.0)
    return Recording(time, {"heater_voltage": drive, channel: output})


@pytest.mark.parametrize(
    ("channel", "section"), [("tip_deflection", "model.deflection"), ("film_resistance", "model.resistance")]
)
def test_the_second_half_is_predicted_from_the_first(channel, section):
    recording = rig(channel)
    model = fit_drive(recording, "heater_voltage", hold_out="end", plays=4)
    law = PlayBank.from_parameters(section, model).egpi()
    found, _ = law.simulate(recording["heater_voltage"])
    y = recording[channel] if channel == "tip_deflection" else -np.log10(recording[channel])
    unseen = held_out(recording["heater_voltage"], "end")
    assert np.mean(np.abs(found - y)[unseen]) < 0.02 * np.ptp(y)


@pytest.mark.parametrize("how", ["end", "blocks"])
def test_held_out_samples_do_not_reach_the_fit(how):
    recording = rig()
    unseen = held_out(recording["heater_voltage"], how)
    spoiled = recording["tip_deflection"].copy()
    spoiled[unseen] = 1.0
    other = Recording(recording.time_s, {**recording.channels, "tip_deflection": spoiled})
    assert 0.25 < np.mean(unseen) < 0.55
    assert fit_drive(recording, "heater_voltage", hold_out=how) == fit_drive(
        other, "heater_voltage", hold_out=how
    )


def test_turning_points_are_never_held_out():
    drive = np.abs(np.arange(100) % 30 - 15.0)
    turns = [k for k in range(1, 99) if (drive[k] - drive[k - 1]) * (drive[k + 1] - drive[k]) < 0]
    assert len(turns) >= 5
    assert not np.any(held_out(drive, "blocks")[turns])


def test_bad_recordings_are_refused():
    recording = rig()
    with pytest.raises(ValueError, match="need the channel heater_power"):
        fit_drive(recording, "heater_power")
    with pytest.raises(ValueError, match="found neither film_resistance nor tip_deflection"):
        fit_drive(
            Recording(recording.time_s, {"heater_voltage": recording["heater_voltage"]}), "heater_voltage"
        )
    gap = recording["heater_voltage"].copy()
    gap[7] = np.nan
    with pytest.raises(ValueError, match=r"found no number at 0\.07 s"):
        fit_drive(
            Recording(recording.time_s, {**recording.channels, "heater_voltage": gap}), "heater_voltage"
        )
