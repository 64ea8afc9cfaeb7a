"""Own robust design: the uncertainty covers what was identified, integral action is real, margins hold everywhere."""

import numpy as np
import pytest
from vo2_control.discretise import robust_law
from vo2_control.generalised_plant import generalised_plant
from vo2_control.hinf import synthesise
from vo2_control.integral_design import (
    central_plant,
    covering_weight,
    integral_design,
)
from vo2_control.sampled_loop import ThermalLag, loop_margins

NOMINAL = ThermalLag(-330e-6, 25.0, 0.38)
PLANTS = [ThermalLag(g, tau, 0.38) for g in (-180e-6, -480e-6) for tau in (20.0, 30.0)]
PERIOD = 0.125


def test_weight_covers_every_identified_plant():
    weight = covering_weight(NOMINAL, PLANTS)
    omega = np.logspace(-4, 1.4, 500)

    def response(plant):
        return plant.gain * np.exp(-1j * omega * plant.dead_time_s) / (1j * omega * plant.time_constant_s + 1)

    for plant in PLANTS:
        error = np.abs(response(plant) / response(NOMINAL) - 1)
        assert np.all(error <= np.abs(weight.response(omega)) * 1.01)
    assert weight.gain < 1.0
    with pytest.raises(ValueError, match="differing sign"):
        covering_weight(NOMINAL, [ThermalLag(330e-6, 25.0)])
    with pytest.raises(ValueError, match="at least one"):
        covering_weight(NOMINAL, [])


def test_central_plant_needs_a_smaller_weight_than_the_mean():
    central = central_plant(PLANTS)
    assert central.gain < 0 and 15 < central.time_constant_s < 30
    omega = np.logspace(-4, 0.4, 200)
    mean = ThermalLag(float(np.mean([p.gain for p in PLANTS])), 25.0, 0.38)
    sizes = [np.log(np.abs(covering_weight(p, PLANTS).response(omega))).mean() for p in (central, mean)]
    assert sizes[0] < sizes[1] - 0.1
    with pytest.raises(ValueError, match="at least one"):
        central_plant([])


def test_integral_action_and_robust_stability():
    design = integral_design(NOMINAL, covering_weight(NOMINAL, PLANTS), bandwidth_rad_s=0.05, effort=1.0)
    result = synthesise(design, largest_gamma=np.inf, expected_sign=-1)
    # loop gain at zero frequency: a lasting error below 0.1 %
    assert abs(result.controller(0)) * abs(NOMINAL.gain) * 1e6 > 1e3
    assert result.robust_stability < 1
    closed = generalised_plant(design).lft(result.controller)
    assert np.real(closed.poles()).max() < 0
    law = robust_law(design, PERIOD, largest_gamma=np.inf).law
    for plant in PLANTS:
        assert loop_margins(law, plant.sampled(PERIOD)).stable
