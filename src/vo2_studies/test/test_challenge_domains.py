"""The concealed hysteresis: a sum of relays (wiping-out, congruent minor loops), with the preset's figures."""

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_studies.challenge.core import Terms, run_core
from vo2_studies.challenge.devices import PRESETS, draw_device, log_resistance, static_deflection
from vo2_studies.challenge.domains import FAMILIES, draw_domains, major_loop

NAMES = list(PRESETS)


def relays(domains, temperatures):
    """Return the metallic fraction after each temperature, by the relay's definition (5.3), grain by grain."""
    on = np.zeros(domains.weight.size, dtype=bool)
    fractions = []
    for temperature in temperatures:
        on[domains.up_metal <= temperature] = True
        on[domains.down_metal > temperature] = False
        fractions.append(domains.weight[on].sum())
    return np.array(fractions)


def track(device, temperatures, terms=None):
    """Return the metallic fraction along temperatures that the core is led through, in small moves."""
    # heat of a body without loss or drive comes through the ambient alone: use the local rise instead
    n = temperatures.size
    _, film, metal, structure, _ = run_core(
        device,
        terms or Terms(),
        current=np.zeros(n),
        ambient=np.full(n, device.ambient),
        local=temperatures - device.ambient,
        step=1e-3,
    )
    assert np.allclose(film[1:], temperatures)
    return metal[1:], structure[1:]


def path(turns, fine=150):
    return np.concatenate([np.linspace(a, b, fine)[1:] for a, b in itertools.pairwise(turns)])


@pytest.mark.parametrize("name", NAMES)
def test_event_loop_equals_relays_by_definition(name):
    device = draw_device(np.random.default_rng(1), name)
    temperatures = path([22.0, 66.0, 54.0, 63.0, 58.0, 80.0, 40.0], fine=40)
    metal, _ = track(device, temperatures)
    assert np.allclose(metal, relays(device.domains, temperatures), atol=1e-12)


@settings(max_examples=15, deadline=None)
@given(
    inner=st.lists(st.floats(54.0, 64.0), min_size=2, max_size=8),
    high=st.floats(65.0, 72.0),
    seed=st.integers(0, 50),
)
def test_wiping_out(inner, high, seed):
    """Minor turns below the last dominant maximum leave no trace once it is exceeded."""
    device = draw_device(np.random.default_rng(seed), NAMES[seed % 2])
    plain, _ = track(device, path([22.0, high, 52.0, high, 60.0]))
    nested, _ = track(device, path([22.0, high, 52.0, *inner, 52.0, high, 60.0]))
    assert nested[-1] == pytest.approx(plain[-1], abs=1e-10)


def test_congruent_minor_loops_only_without_feedback():
    """The same excursion 58-62 degC has the same height from any history: relays are congruent, a moving model not."""
    device = draw_device(np.random.default_rng(4), "integrated")

    def heights(terms):
        found = []
        for turns in ([22.0, 62.0, 58.0, 62.0], [22.0, 85.0, 58.0, 62.0]):
            metal, _ = track(device, path(turns), terms)
            found.append(metal[-1] - metal[-150])
        return found

    low, high = heights(Terms())
    assert low == pytest.approx(high, abs=2e-4)
    low, high = heights(Terms(feedback=2.0))
    assert abs(low - high) > 2e-3


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("name", NAMES)
def test_material_statistics_are_the_presets(name, family):
    preset = PRESETS[name]
    values = []
    for seed in range(14):
        domains = draw_device(np.random.default_rng(seed), name, family=family).domains
        width = domains.up_metal - domains.down_metal
        offset = domains.up_structure - domains.up_metal
        weight = domains.weight

        def moments(x, weight=weight):
            mean = np.sum(weight * x)
            return [mean, np.sqrt(np.sum(weight * (x - mean) ** 2))]

        values.append(moments(domains.up_metal) + moments(width) + moments(offset))
        assert weight.sum() == pytest.approx(1)
        assert np.all(width > 0)
    mean = np.mean(values, axis=0)
    assert mean[0] == pytest.approx(preset.heating[0], abs=0.8)
    assert mean[1] == pytest.approx(preset.heating[1], rel=0.12)
    assert mean[2] == pytest.approx(preset.width[0], rel=0.08)
    assert mean[3] == pytest.approx(preset.width[1], rel=0.2)
    assert mean[4] == pytest.approx(preset.offset[0], abs=0.3)
    assert mean[5] == pytest.approx(preset.offset[1], rel=0.12)


FILM: dict[str, Any] = {
    "heating_mean": 62,
    "heating_sd": 3.5,
    "width_mean": 7,
    "width_sd": 2,
    "offset_mean": 0.8,
    "offset_sd": 1.8,
}


def scatter(family, misfit, seed=2):
    """Return the relative scatter from play to play of the heating branch's steepness, where plays overlap."""
    domains = draw_domains(np.random.default_rng(seed), **FILM, misfit=misfit, family=family)
    up = domains.up_metal.reshape(24, -1)
    # the middle half of a play is least bent by its envelope's tails
    steepness = (up[:, 375] - up[:, 125])[:8]
    return np.std(np.diff(steepness)) / np.sqrt(2) / np.mean(steepness)


@pytest.mark.parametrize("family", FAMILIES)
def test_misfit_scatters_envelope_slopes(family):
    assert np.mean([scatter(family, 0.0, seed) for seed in range(5)]) < 0.04
    assert 0.06 < np.mean([scatter(family, 0.1, seed) for seed in range(5)]) < 0.16


def test_unusable_film():
    for wrong in ({"misfit": 0.5}, {"family": "balls"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            draw_domains(np.random.default_rng(2), **FILM, **wrong)


def test_play_family_is_a_generalised_play_without_misfit():
    """Grains of one play, read as one operator, equal w = max(g_R - r, min(g_L + r, w)) between its envelopes."""
    domains = draw_domains(np.random.default_rng(3), **FILM, misfit=0.0)
    up, down = (x.reshape(24, -1) for x in (domains.up_metal, domains.down_metal))
    grid = np.linspace(50, 70, 400)
    # the play of smallest and of largest radius trace one heating envelope g_R = y + r, shifted by r in y
    share = [np.searchsorted(np.sort(u), grid) / u.size for u in (up[0], up[-1])]
    # y of play j runs over (1 - r)(2 share - 1); where both are inside, their difference is constant
    width = [np.median(u - d) for u, d in zip(up, down, strict=True)]
    assert np.all(np.diff(width) > 0)
    inside = (share[0] > 0.05) & (share[0] < 0.95) & (share[1] > 0.05) & (share[1] < 0.95)
    best = min(
        np.std((2 * share[0] - 1)[inside] * (1 - r0) - (2 * share[1] - 1)[inside] * (1 - r1))
        for r0 in np.linspace(0, 0.1, 21)
        for r1 in np.linspace(0.1, 0.9, 161)
    )
    assert best < 4e-3


@pytest.mark.parametrize("name", NAMES)
def test_ranges_are_the_presets_within_device_spread(name):
    preset = PRESETS[name]
    for seed in range(12):
        device = draw_device(np.random.default_rng(seed), name)
        temperature = np.linspace(device.cold_temperature, device.hot_temperature, 300)
        up_m, down_m, up_s, down_s = major_loop(device.domains, temperature)
        assert np.all(np.diff(up_m) >= 0)
        assert np.all(down_m >= up_m - 1e-12)
        resistance = 10 ** log_resistance(device, up_m, temperature)
        assert resistance.max() == pytest.approx(preset.resistance[1], rel=0.08)
        assert resistance.min() == pytest.approx(preset.resistance[0], rel=0.08)
        deflection = np.concatenate([static_deflection(device, s, temperature) for s in (up_s, down_s)])
        assert np.ptp(deflection) == pytest.approx(np.ptp(preset.deflection), rel=0.08)
        assert deflection.min() == pytest.approx(preset.deflection[0], abs=2e-8)
        # not monotonic: it falls where only one phase is present
        curve = static_deflection(device, up_s, temperature)
        assert curve[20] < curve[0]
        assert curve[-1] < curve.max()
