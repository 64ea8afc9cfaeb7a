"""Scenarios of the reproduction on a real graph: complete in the bag, on the reference, with the noise asked for."""

import numpy as np
import pytest
from vo2_control.pid import PUBLISHED_PELTIER_PID
from vo2_identification.bags import read_bag
from vo2_models.device import truth
from vo2_models.parameters import Value
from vo2_studies.reproduce.identified import identify
from vo2_studies.reproduce.peltier import NOISE_A, current_noise
from vo2_studies.reproduce.scenarios import GraphLoop, run_loops

SEED = 5


def test_a_short_step_scenario_ends_in_a_complete_bag(tmp_path):
    _, parameters = identify(truth("integrated", seed=SEED), SEED)
    wanted = np.repeat([20e-6, 35e-6], 150)
    loops = [
        GraphLoop("/composite", {"kind": "composite", **parameters}, {"kind": "pi", **parameters}),
        GraphLoop("/again", {"kind": "composite", **parameters}, {"kind": "pi", **parameters}),
    ]
    found = run_loops(loops, "integrated", SEED, wanted, 0, tmp_path / "scenario")
    assert (tmp_path / "scenario" / "bag").is_dir()
    for data in found:
        assert data.time_s.size == wanted.size
        np.testing.assert_allclose(data.reference_m[:-1], wanted[1:], atol=1e-12)
        assert np.all(np.isfinite(data.estimate_m))
    settled = np.abs(found[0].reference_m - found[0].true_m)[[120, 280]]
    assert settled.max() < 2e-6
    # what the loops are told reaches them at the same sample, whatever the wall time at which it comes
    np.testing.assert_array_equal(found[1].estimate_m, found[0].estimate_m)
    np.testing.assert_array_equal(found[1].true_m, found[0].true_m)


def test_the_disturbance_adds_the_noise_of_the_stamp(tmp_path):
    _, parameters = identify(truth("peltier", seed=SEED), SEED)
    law: dict[str, Value] = {
        "kind": "pid",
        "pid.kp": PUBLISHED_PELTIER_PID.kp,
        "limits.lower_a": -1.2,
        "limits.upper_a": 1.2,
    }
    estimator = {"kind": "polynomial", **parameters}
    loops = [GraphLoop("/clean", estimator, law), GraphLoop("/noisy", estimator, law, disturbance_seed=SEED)]
    wanted = np.full(200, 10e-6)
    run_loops(loops, "peltier", SEED, wanted, 0, tmp_path / "scenario")
    clean, noisy = (
        read_bag(tmp_path / "scenario" / "bag", namespace=f"/{name}", roles=("command",))[0]["command"]
        for name in ("clean", "noisy")
    )
    noise = current_noise(wanted.size, SEED)
    difference = noisy["heater_current"][0] - clean["heater_current"][0]
    assert difference == pytest.approx(noise[0], abs=1e-12)
    # later samples differ by the loops' answers to the noise as well, which the heater's lag keeps small
    rest = noisy["heater_current"][1:100] - clean["heater_current"][1:100] - noise[1:100]
    assert np.abs(rest).max() < 0.5 * NOISE_A < 2 * np.abs(noise).max()
