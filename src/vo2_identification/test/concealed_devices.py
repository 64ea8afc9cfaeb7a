"""Simulated devices whose hysteresis is an ensemble of domains, their calibrations and recordings."""

from dataclasses import replace
from functools import cache

import numpy as np
from vo2_models.device import preset, surrogate_of_temperature, truth
from vo2_models.identification.excitation import Excitation, composite_recording, damped_oscillation
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

DEVICE, SEED = "integrated", 11
MEASURED = (HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION)


def measured(recording: Recording) -> Recording:
    channels = {k: v for k, v in recording.channels.items() if k in MEASURED}
    return Recording(recording.time_s, channels, recording.device)


def concealed(
    effects=None, *, seed=4, samples=4000, colour=0.0, device_seed=SEED, device=DEVICE, moved=(), room=None
) -> Recording:
    nominal = preset(device)
    dt = nominal.sample_period
    cold, hot = nominal.operating_range
    begin, end = surrogate_of_temperature(device, np.array([50.0, 70.0]))
    current = composite_recording(
        cold, hot, transition=(begin, end), duration_s=samples * dt, sample_period_s=dt, seed=seed
    ).sample(dt)
    concealing = truth(device, seed=device_seed, effects=effects or {}, colour=colour)
    c = concealing.coefficients.copy()
    for place, factor, added in moved:  # constants of another day
        c[place] = factor * c[place] + added
    concealing = replace(concealing, coefficients=c)
    if room is not None:  # kelvins that the room is warmer, evenly over the recording
        concealing = concealing.with_course("ambient_drift", room)
    return measured(concealing.simulate(current, seed=seed + 100))


def calibration(device_seed=SEED, device=DEVICE, effects=None, *, samples=12_000) -> Recording:
    """Smaller and smaller loops at one rate, on which a lag and a wider loop look the same."""
    nominal = preset(device)
    low, high = sorted(nominal.steady_temperature(i) for i in nominal.operating_range)
    levels = damped_oscillation(np.linspace(low, high, 31), reversals_only=True)
    rate = float(np.sum(np.abs(np.diff(levels)))) / (samples * nominal.sample_period)
    sweep = Excitation.at_rate(levels, rate_per_s=rate).sample(nominal.sample_period)
    current = surrogate_of_temperature(device, sweep)
    return truth(device, seed=device_seed, effects=effects or {}).simulate(current, seed=1)


@cache
def calibrated(device_seed=SEED, device=DEVICE, read=measured):
    """Model fitted to the calibration, once a session."""
    _, found = fit_model([read(calibration(device_seed, device))], device, plays=12, self_sensing=False)
    return found
