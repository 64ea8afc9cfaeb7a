"""A model for the nodes that need one."""

import numpy as np
import pytest
from vo2_models.device import truth
from vo2_models.identification.device_fit import fit_device
from vo2_models.identification.excitation import damped_oscillation


@pytest.fixture(scope="session")
def fitted_model():
    """`model.*` fitted to the noisy recording of a simulated device that is another kind of model."""
    device = truth("integrated", seed=2, domains=1500)
    share = damped_oscillation(np.linspace(0, 1, 21))
    recording = device.simulate(np.repeat(3.68e-3 + share * (8.49e-3 - 3.68e-3), 10), seed=3)
    return fit_device([recording], "integrated").model.to_parameters()
