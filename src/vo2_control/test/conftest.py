"""Models for the nodes and the designs that need one."""

import numpy as np
import pytest
from vo2_models.device import truth
from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation


@pytest.fixture(scope="session")
def fitted_model():
    """`model.*` fitted to the noisy recording of a simulated device that is another kind of model."""
    device = truth("integrated", seed=2, domains=1500)
    share = damped_oscillation(np.linspace(0, 1, 21))
    recording = device.simulate(np.repeat(3.68e-3 + share * (8.49e-3 - 3.68e-3), 10), seed=3)
    return fit_device([recording], "integrated").model.to_parameters()


@pytest.fixture(scope="session")
def crude_model():
    """Device name -> one tanh loop with its published transition: what a first fit would give, not the device itself."""

    def make(device):
        hot, spread, extent = (62.0, 3.5, 57e-6) if device == "integrated" else (64.0, 2.5, 70e-6)
        slope = 0.8 / spread
        bank = PlayBank(
            weights=[extent / 2], radii=[0.0], rising_slopes=[slope], rising_offsets=[-slope * hot],
            falling_slopes=[slope], falling_offsets=[-slope * (hot - 7.0)], polynomial=[extent / 2],
        )  # fmt: skip
        return DeviceModel(device, deflection=bank)

    return make
