"""Public names, and the published models of chapter 7 as they are printed."""

import numpy as np
import pytest
from vo2_models.hysteresis import EGPI, GPI, Linear, OrderWarning, RobustInverse, TanhEnvelopes

from vo2_models import hysteresis

OPERATING = (3.68e-3, 8.49e-3)
RADII = np.arange(6) / 6


def test_every_public_name_loads():
    for name in hysteresis.__all__:
        assert getattr(hysteresis, name).__doc__
    with pytest.raises(AttributeError, match="has no attribute 'Stop'"):
        _ = hysteresis.Stop


def table_7_1(**options):
    """Resistance: the model's output is minus the resistance, weights in units of 1e5 ohm (errata)."""
    weights = 1e5 * np.array([0.415, 0.648, 0.325, 0, 0.081, 0.618])
    return GPI(RADII, weights, TanhEnvelopes(624.9, -3.656, 519.7, -2.984), -132556.3, OPERATING, **options)


def table_7_2(**options):
    """Deflection in micrometre against current in ampere."""
    envelopes = TanhEnvelopes(
        [1202.6, 1376.2, 1243.0, 1173.7, 788.8, 788.8],
        [-8.67, -12.15, -10.12, -7.42, -10.83, -11.21],
        [982.5, 1754.8, 2169.2, 838.1, 1864.7, 1623.2],
        [-6.49, -11.13, -11.56, -6.24, -6.46, -15.52],
    )
    weights = [27.24, 5.35, 3.18, 12.84, 1.00, 26.68]
    return EGPI(RADII, weights, envelopes, Linear(-8874.3), 143.29, OPERATING, **options)


@pytest.mark.parametrize(("build", "excess", "play"), [(table_7_1, 0.051, 0), (table_7_2, 0.020, 3)])
def test_published_envelopes_cross_and_are_refused(build, excess, play):
    with pytest.raises(ValueError, match=rf"envelopes: found .* for play {play}, need gamma_R"):
        build()
    with pytest.warns(OrderWarning):
        model = build(on_disorder="warn")
    found, _, where = model.order_excess(*OPERATING)
    assert found == pytest.approx(excess, abs=1e-3)
    assert where == play


def test_published_deflection_model_as_printed():
    """Spans about 49 to 96 um over the operating current (errata), and can be inverted although it is not monotone."""
    model = table_7_2(on_disorder="accept")
    sweep = np.concatenate([np.linspace(*OPERATING, 400), np.linspace(*OPERATING[::-1], 400)])
    output, _ = model.simulate(sweep)
    assert output.min() == pytest.approx(48, abs=1.5)
    assert output.max() == pytest.approx(95.5, abs=1.5)
    inverse = RobustInverse(model)
    assert not inverse.monotone
    state = model.initial_state(v=OPERATING[0])
    for wish in 70 + 15 * np.sin(np.linspace(0, 12, 60)):
        assert inverse.plan(wish, state).reached


def test_published_plays_5_and_6_never_switch_from_lower_saturation():
    model = table_7_2(on_disorder="accept")
    plays = model.play_outputs(np.linspace(*OPERATING, 200))
    assert np.all(np.ptp(plays[:, :4], axis=0) > 0.1)
    assert np.all(np.ptp(plays[:, 4:], axis=0) == 0)
