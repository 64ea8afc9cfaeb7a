"""Structured singular values and margins against the libraries that others use for them: SLICOT and python-control."""

import control
import numpy as np
import pytest
from vo2_control.controller import LinearLaw
from vo2_control.generalised_plant import RobustDesign, generalised_plant
from vo2_control.hinf import PUBLISHED_CONTROLLER, synthesise
from vo2_control.mu import closed_loop_response, mu_sweep
from vo2_control.sampled_loop import ThermalLag, loop_margins

slycot = pytest.importorskip("slycot")


@pytest.mark.parametrize("controller", ["optimal", "printed"])
def test_structured_singular_values_are_those_of_slicot(controller):
    """AB13MD takes square matrices: what the performance block lacks of one is filled with zeros, which changes nothing."""
    design = RobustDesign()
    law = synthesise(design).controller if controller == "optimal" else PUBLISHED_CONTROLLER
    plant = generalised_plant(design)
    frequency = np.logspace(-3, 2, 40)
    response = closed_loop_response(plant, law, frequency)
    size = max(response.shape[1:])
    square = np.zeros((frequency.size, size, size), complex)
    square[:, : response.shape[1], : response.shape[2]] = response
    theirs = [slycot.ab13md(one, [1, size - 1], [2, 2])[0] for one in square]
    assert mu_sweep(plant, law, frequency).upper == pytest.approx(theirs, rel=1e-3)


@pytest.mark.parametrize("lag", [3.0, 10.0, 40.0])
@pytest.mark.parametrize("delay", [0.0, 0.4, 2.5])
@pytest.mark.parametrize(("gain", "integral"), [(0.3, 0.02), (0.8, 0.05), (1.5, 0.1)])
def test_margins_are_those_of_python_control(gain, integral, lag, delay):
    """With skew 1 and -1 a disk margin is the inverse of the largest sensitivity and complementary sensitivity."""
    period, points = 1.0, 1500
    plant = ThermalLag(1.0, lag, delay).sampled(period)
    one, none = np.array([[1.0]]), np.zeros(1)
    inputs = np.array([[integral, -integral]])
    law = LinearLaw(one, inputs, np.array([1.0]), np.array([gain, -gain]), none, period)
    ours = loop_margins(law, plant, points=points)
    feedback = control.ss(one, [[integral]], [[1.0]], [[gain]], period)
    loop = control.ss(plant.a, plant.b[:, None], plant.c[None], 0.0, period) * feedback

    def stable(factor):
        return bool(np.all(np.abs(control.feedback(factor * loop, 1).poles()) < 1.0))

    assert ours.stable == stable(1.0)
    if not ours.stable:
        assert ours.sensitivity_peak == np.inf
        return
    frequency = np.pi / period * np.logspace(-6, 0, points)
    for skew, peak in ((1.0, ours.sensitivity_peak), (-1.0, ours.complementary_peak)):
        assert control.disk_margins(loop, frequency, skew)[0] == pytest.approx(1.0 / peak, rel=1e-6)
    # not by control.margin, which leaves out the loop's gain at half the sampling rate
    assert stable(0.97 * ours.gain_margin) and not stable(1.03 * ours.gain_margin)  # on a grid of frequencies
    assert ours.phase_margin_deg == pytest.approx(control.margin(loop)[1], abs=2.0)
