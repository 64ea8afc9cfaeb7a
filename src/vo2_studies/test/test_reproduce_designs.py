"""The grid of own robust designs: every law that is offered keeps the limit at every plant, and a refusal counts them."""

import pytest
from vo2_control.hinf import DesignRefused
from vo2_control.sampled_loop import ThermalLag, loop_margins
from vo2_studies.reproduce.own_designs import BANDWIDTHS_RAD_S, EFFORTS, integral_laws

NOMINAL = ThermalLag(-330e-6, 25.0, 0.38)
PLANTS = [ThermalLag(g, tau, 0.38) for g in (-180e-6, -480e-6) for tau in (20.0, 30.0)]
PERIOD = 0.125


@pytest.mark.slow
def test_laws_keep_the_limit_at_every_plant():
    for found in integral_laws(NOMINAL, PLANTS, PERIOD, expected_sign=-1):
        for plant in PLANTS:
            margins = loop_margins(found.law, plant.sampled(PERIOD))
            assert margins.stable and max(margins.sensitivity_peak, margins.complementary_peak) <= 1.61


@pytest.mark.slow
def test_refusal_counts_the_designs():
    with pytest.raises(DesignRefused, match=f"none of {len(BANDWIDTHS_RAD_S) * len(EFFORTS)} designs"):
        integral_laws(NOMINAL, PLANTS, PERIOD, max_sensitivity=1.0001, expected_sign=1)
