"""A linear law by zeros, poles and gain."""

import numpy as np
import pytest
from vo2_control.controller import CurrentLimits, LinearController
from vo2_control.designs import design_controller
from vo2_control.discretise import discrete_law
from vo2_control.hinf import PUBLISHED_CONTROLLER
from vo2_control.zpk import law_from_zpk, zpk_from_parameters

PERIOD_S = 0.125
PRINTED = {
    "zpk.gain": -918.0,
    "zpk.zeros_rad_s": [-1.1, -5.3, -8.2, -100.0],
    "zpk.poles_rad_s": [-40830.0, -89.0, -1.0, -4.4],
    "zpk.poles_imaginary_rad_s": [0.0, 0.0, 0.0, 1.6],
}


def test_the_printed_controller_is_the_library_s():
    law = law_from_zpk(PRINTED, PERIOD_S, expected_sign=-1)
    known = discrete_law(PUBLISHED_CONTROLLER, PERIOD_S)
    assert law.d == pytest.approx(known.d, rel=1e-12)
    assert np.sort(np.abs(np.linalg.eigvals(law.a))) == pytest.approx(
        np.sort(np.abs(np.linalg.eigvals(known.a)))
    )


def test_a_law_answers_as_its_equation_does():
    """An integrator, gain / s by the trapezoidal rule: a steady error of 1 um commands gain times the time."""
    law = law_from_zpk({"zpk.gain": 2e-3, "zpk.poles_rad_s": [0.0]}, PERIOD_S, expected_sign=1)
    controller = LinearController(law, CurrentLimits(-10.0, 10.0))
    commands = [controller.update(1e-6, 0.0) for _ in range(200)]
    expected = 2e-3 * PERIOD_S * (np.arange(200) + 0.5)
    assert np.diff(commands) == pytest.approx(np.diff(expected), rel=1e-9)


def test_pairs_are_written_out():
    zeros, poles, gain = zpk_from_parameters(PRINTED)
    assert (zeros.size, poles.size, gain) == (4, 5, -918.0)
    assert sorted(poles.imag) == [-1.6, 0.0, 0.0, 0.0, 1.6]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"zpk.gain": 918.0}, r"zpk.gain: found 918 A/um, .* sign \+1, need -1 on this device"),
        ({"zpk.gain": 0.0}, "zpk.gain: found 0 A/um, need another one"),
        ({"zpk.poles_imaginary_rad_s": [1.6]}, "zpk.poles_imaginary_rad_s: found 1 values, need none or 4"),
        ({"zpk.poles_rad_s": [-1.0, -2.0, -3.0, 1.0]}, "zpk.poles_rad_s: found 1, need -inf to 0 rad/s"),
        ({"zpk.zeros_rad_s": [-1.0] * 6}, "zpk.zeros_rad_s: found 6 zeros, need at most 5"),
    ],
)
def test_what_makes_no_law_is_one_line(change, said):
    with pytest.raises(ValueError, match=said) as refused:
        design_controller(
            "zpk", preset="peltier_chapter8", sample_period_s=PERIOD_S, values={**PRINTED, **change}
        )
    assert "\n" not in str(refused.value)
