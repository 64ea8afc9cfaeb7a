"""The estimator as a node: the library's numbers, and one clear message for each kind of bad input."""

import math
from functools import cache

import numpy as np
import pytest
from vo2_estimation.estimator_node import EstimatorNode
from vo2_estimation.schemes import make_scheme
from vo2_interface.model import model_parameters
from vo2_interface.parameters import ros_parameters
from vo2_interface.testing import bench
from vo2_models.device import DeviceModel, truth
from vo2_models.device.description import preset
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.self_sensing import PolynomialSelfSensing, self_sensing

import vo2_models as vo2

CHANNELS = ("tip_deflection", "temperature_surrogate", "tip_deflection_bound")
MS = 1_000_000
MODEL = {
    "model.device": "integrated",
    **PolynomialSelfSensing.fit(
        np.geomspace(1e4, 2e5, 40), np.linspace(5e-5, 2e-6, 40), degree=3
    ).to_parameters(),
}


def with_model(node, model=MODEL):
    result = node.set_parameters_atomically(ros_parameters(model))
    assert result.successful, result.reason


def polynomial():
    return bench(["--ros-args", "-p", "kind:=polynomial"])


def answer(rig, stamp_ns, values):
    """Say one sample and return the estimate of its stamp."""
    rig.say("/vo2/measurement", stamp_ns, values)
    rig.until(lambda: any(stamp == stamp_ns for stamp, _ in rig.heard["/vo2/estimate"]))
    return [values for stamp, values in rig.heard["/vo2/estimate"] if stamp == stamp_ns][-1]


def test_estimates_are_those_of_the_library():
    scheme = self_sensing("polynomial", MODEL)
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode))
        for k, resistance in enumerate([2e5, 9e4, 1.2e4]):
            found = answer(rig, k * MS, {"film_resistance": resistance, "heater_current": 0.005})
            assert found[0] == scheme.update(resistance, scheme.initial_state()).deflection


def test_kind_drive_runs_the_whole_model_that_fit_wrote():
    levels = 3.68e-3 + 4.81e-3 * np.repeat(vo2.damped_oscillation(np.linspace(0, 1, 13)), 10)
    model = vo2.fit(vo2.simulate("integrated", levels, seed=1), "integrated")
    expected = DeviceModel.from_parameters(model).simulate(levels[:40], noise=False)
    with bench(["--ros-args", "-p", "kind:=drive"]) as rig:
        rig.hear("/vo2/estimate", ("tip_deflection", "film_resistance"))
        with_model(rig.add(EstimatorNode), model)
        for k, current in enumerate(levels[:40]):
            found = answer(rig, k * MS, {"heater_current": current, "film_resistance": 1e5})
            assert found[0] == pytest.approx(expected["true_tip_deflection"][k], abs=1e-15)
            assert found[1] == pytest.approx(expected["true_film_resistance"][k], rel=1e-9)
        rig.until(lambda: "without feedback from a sensor" in rig.status("estimator: model")[0])
        # it has no bound that could grow over what it did not see
        answer(rig, 45 * MS, {"heater_current": levels[40], "film_resistance": 1e5})
        rig.until(lambda: "is not in the estimate" in rig.status("estimator: gaps")[0])


@pytest.mark.parametrize("every_us", [10_000, 250])
def test_kind_drive_steps_for_as_long_as_passes_between_samples(every_us):
    """Rates other than that of the device file (1 kHz): the lag is one of time and not of samples."""
    device = preset("integrated")
    bank = PlayBank(
        weights=[25e-6], radii=[0.0], rising_slopes=[0.2], rising_offsets=[-12.4],
        falling_slopes=[0.2], falling_offsets=[-11.0], polynomial=[25e-6],
    )  # fmt: skip
    model = DeviceModel("integrated", {"thermal.time_constant": 12e-3}, deflection=bank)
    held = np.repeat([0.0068, 0.0062, 0.0074], 20)
    expected = model.simulate(held, dt=every_us * 1e-6, noise=False)["true_tip_deflection"]
    with bench(["--ros-args", "-p", "kind:=drive"]) as rig:
        rig.hear("/vo2/estimate", ("tip_deflection", "film_resistance"))
        node = rig.add(EstimatorNode)
        with_model(node, model.to_parameters())
        stamps = [k * every_us * 1000 for k in range(held.size)]
        found = [answer(rig, t, {"heater_current": i})[0] for t, i in zip(stamps, held, strict=True)]
        # nobody knows how long the first sample's drive has flowed
        assert found[8:] == pytest.approx(expected[8:], abs=0.01 * device.deflection_range)
        assert node._diagnostics.level("period") == "ok"


def test_without_model_every_estimate_is_nan_and_the_remedy_is_told_once():
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        node = rig.add(EstimatorNode)
        assert all(math.isnan(value) for value in answer(rig, MS, {"film_resistance": 1e5}))
        node._diagnostics.beat()
        rig.until(lambda: "no model yet" in rig.status("estimator: model")[0])
        assert "run the identifier" in rig.status("estimator: model")[0]
        with_model(node)
        assert math.isfinite(answer(rig, 2 * MS, {"film_resistance": 1e5})[0])


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 0.0, -5.0])
def test_an_unusable_resistance_gives_nan_and_says_so_and_recovers(value):
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode))
        assert math.isfinite(answer(rig, MS, {"film_resistance": 1e5})[0])
        assert math.isnan(answer(rig, 2 * MS, {"film_resistance": value})[0])
        rig.until(lambda: "film_resistance on measurement is" in rig.status("estimator: input")[0])
        assert math.isfinite(answer(rig, 3 * MS, {"film_resistance": 1e5})[0])
        rig.until(lambda: "is back" in rig.status("estimator: input")[0])


def test_an_absent_channel_is_named_with_those_there_are():
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode))
        assert math.isnan(answer(rig, MS, {"heater_current": 0.005, "tip_deflection": 1e-5})[0])
        rig.until(
            lambda: "absent (there are heater_current, tip_deflection)" in rig.status("estimator: input")[0]
        )


def test_a_repeated_stamp_is_answered_with_the_same_bytes():
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode))
        first = answer(rig, 5 * MS, {"film_resistance": 1e5})
        rig.say("/vo2/measurement", 5 * MS, {"film_resistance": 2e4})
        rig.until(lambda: len(rig.heard["/vo2/estimate"]) == 2)
        stamp_ns, again = rig.heard["/vo2/estimate"][1]
        assert (stamp_ns, again[0]) == (5 * MS, first[0])


def test_late_samples_are_dropped_and_counted_and_a_source_that_started_anew_is_told():
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        node = rig.add(EstimatorNode)
        with_model(node)
        answer(rig, MS, {"film_resistance": 1e5})
        restarts = []
        node._scheme.restart = lambda: restarts.append(1)
        for k in (5, 2, 6, 4, 3, 7):
            rig.say("/vo2/measurement", k * MS, {"film_resistance": 1e5})
        rig.until(lambda: rig.heard["/vo2/estimate"] and rig.heard["/vo2/estimate"][-1][0] == 7 * MS)
        assert [stamp // MS for stamp, _ in rig.heard["/vo2/estimate"]] == [1, 5, 6, 7]
        assert not restarts and node._diagnostics._present["late"][2] == {"count": "2"}
        # a plant that started anew in lockstep repeats its first sample until it is answered
        for _ in range(4):
            rig.say("/vo2/measurement", 3 * MS, {"film_resistance": 1e5})
            rig.spin(0.2)
        rig.until(lambda: "jumped back" in rig.status("estimator: stamps")[0])
        assert rig.heard["/vo2/estimate"][-1][0] == 3 * MS and restarts == [1]


def test_a_model_that_lacks_what_the_scheme_needs_is_refused_with_the_reason():
    with bench(["--ros-args", "-p", "kind:=composite"]) as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode))
        assert math.isnan(answer(rig, MS, {"film_resistance": 1e5})[0])
        rig.until(lambda: "model.resistance: found no law" in rig.status("estimator: model")[0])


def test_a_deflection_that_the_resistance_does_not_determine_is_told_with_the_scheme():
    even = PlayBank([0.0], [0.0], [0.25], [-15.5], [0.25], [-14.5], [-5.0, 0.12, -1e-3])
    tip = PlayBank([3e-5], [0.0], [0.25], [-15.5], [0.25], [-14.5], [0.0])
    model = DeviceModel("integrated", resistance=even, deflection=tip).to_parameters()
    note = make_scheme("composite", "", model, (1e2, 1e5)).note
    assert "is not unique" in note and "the model has no error bounds" in note


def test_the_model_says_which_device_it_is_and_a_preset_that_differs_is_told():
    other = {**MODEL, "model.device": "peltier"}
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        node = rig.add(EstimatorNode)
        with_model(node, other)
        assert math.isfinite(answer(rig, MS, {"film_resistance": 1e5})[0])
        assert node._device.id == "peltier"
    with bench(["--ros-args", "-p", "kind:=polynomial", "-p", "preset:=peltier"]) as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode))
        assert math.isnan(answer(rig, MS, {"film_resistance": 1e5})[0])
        rig.until(lambda: "found integrated, need the preset peltier" in rig.status("estimator: model")[0])


def test_a_stuck_sensor_gives_nan_until_the_reading_changes_and_is_told():
    model = {**MODEL, "model.sensors.film_resistance.noise": 0.002}
    with polynomial() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode), model)
        readings = [1e5, 1e5 + 5.0, *[1e5] * 12, 9e4]
        found = [
            answer(rig, k * MS, {"film_resistance": r, "heater_current": 0.005 + 1e-5 * k})[0]
            for k, r in enumerate(readings)
        ]
        finite = [math.isfinite(value) for value in found]
        first = finite.index(False)
        assert 8 <= first <= 11
        assert finite == [True] * first + [False] * (14 - first) + [True]
        rig.until(lambda: "stuck or saturated at 100000 ohm" in str([text for _, text, _ in rig.statuses]))
        rig.until(lambda: "is back" in rig.status("estimator: input")[0])


def test_a_reading_beyond_the_given_range_is_saturated_unless_the_check_is_off():
    for off in (False, True):
        with bench(["--ros-args", "-p", "kind:=polynomial", "-p", f"sensor.check:={str(not off).lower()}",
                    "-p", "sensor.upper_ohm:=120000.0"]) as rig:  # fmt: skip
            rig.hear("/vo2/estimate", CHANNELS)
            with_model(rig.add(EstimatorNode))
            assert math.isfinite(answer(rig, MS, {"film_resistance": 1e5, "heater_current": 0.005})[0])
            found = answer(rig, 2 * MS, {"film_resistance": 1.2e5, "heater_current": 0.005})[0]
            assert math.isfinite(found) == off


@cache
def identified():
    """A model with a composite law, fitted once."""
    from vo2_models.device import truth
    from vo2_models.identification.excitation import damped_oscillation
    from vo2_models.workflow import fit

    share = damped_oscillation(np.linspace(0.0, 1.0, 13))
    recording = truth("integrated", seed=1, domains=1500).simulate(
        np.repeat(3.68e-3 + 4.81e-3 * share, 10), seed=1
    )
    return fit(recording, "integrated")


def dynamic(frequency):
    """A model with a composite law and a mode of this frequency, 0 for none."""
    mode = {"frequency": frequency, "damping": 0.02, "share": 1.0, "sample_period": 1e-3}
    # what a later diagnosis reads is no parameter of the node
    declared = {parameter.name for parameter in model_parameters()}
    return {
        **{name: value for name, value in identified().items() if name in declared},
        **{f"model.self_sensing.mode.{name}": value if frequency else 0.0 for name, value in mode.items()},
    }


def test_unidentified_dynamics_are_told():
    with bench(["--ros-args", "-p", "kind:=dynamic"]) as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode), dynamic(0.0))
        assert math.isfinite(answer(rig, MS, {"film_resistance": 1e5})[0])
        rig.until(lambda: "dynamics unidentified" in rig.status("estimator: model")[0])


def test_another_sample_period_than_that_of_the_dynamics_is_told_and_taken_back():
    with bench(["--ros-args", "-p", "kind:=dynamic"]) as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode), dynamic(150.0))
        for k in range(12):
            answer(rig, 2 * k * MS, {"film_resistance": 1e5 + k})
        rig.until(lambda: "samples come every 0.002 s" in rig.status("estimator: period")[0])
        answer(rig, 23 * MS, {"film_resistance": 1e5})
        rig.until(lambda: "as the model" in rig.status("estimator: period")[0])


def faulty(rng, count):
    """Numbers of 0 to `count` - 1 as a bad link delivers them: a fifth lost, doubled, late or in the wrong order."""
    arriving = []
    for k in range(count):
        fault = rng.choice(["none", "lost", "doubled", "late", "swapped"], p=[0.8, 0.05, 0.05, 0.05, 0.05])
        if fault == "lost":
            continue
        arriving.append((k, k))
        if fault == "doubled":
            arriving.append((k, k))
        elif fault == "late":
            arriving.append((k + rng.uniform(1.0, 60.0), k))
        elif fault == "swapped":
            arriving[-1] = (k + 1.5, k)
    return [k for _, k in sorted(arriving)]


def test_a_clock_that_jitters_loses_no_samples():
    """Of a rig in wall time: a sample that comes late is followed by one that comes early."""
    late = np.random.default_rng(5).uniform(0.0, 0.4, 200)
    with bench() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        with_model(rig.add(EstimatorNode), dynamic(0.0))
        for k, share in enumerate(late):
            rig.say("/vo2/measurement", round((1 + k + share) * MS), {"film_resistance": 1e5})
            rig.spin(0.002)
        rig.until(lambda: rig.heard["/vo2/estimate"] and rig.heard["/vo2/estimate"][-1][0] > 200 * MS)
        assert not any(name == "vo2/estimator: memory" for name, _, _ in rig.statuses)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_with_a_fifth_of_the_samples_lost_doubled_late_or_out_of_order_the_bound_holds(seed):
    rng = np.random.default_rng(seed)
    currents = np.repeat(rng.uniform(3.68e-3, 8.49e-3, 120), 5)
    ends = np.repeat([3.68e-3, 8.49e-3, 3.68e-3, 6e-3], 10)
    recording = truth("integrated", seed=1, domains=1500).simulate(
        np.concatenate([currents, ends]), seed=seed
    )
    resistance, true = recording["film_resistance"], recording["true_tip_deflection"]
    model = dynamic(0.0)
    whole, _ = self_sensing("composite", model).estimate(resistance)
    arriving = [*faulty(rng, currents.size), *range(currents.size, resistance.size)]
    with bench() as rig:
        rig.hear("/vo2/estimate", CHANNELS)
        node = rig.add(EstimatorNode)
        with_model(node, model)
        for k in arriving:
            rig.say("/vo2/measurement", (1 + k) * MS, {"film_resistance": resistance[k]})
            rig.spin(0.002)
        rig.until(
            lambda: rig.heard["/vo2/estimate"] and rig.heard["/vo2/estimate"][-1][0] == resistance.size * MS
        )
        statuses = {name for name, _, _ in rig.statuses}
        rig.until(lambda: "known again" in rig.status("estimator: memory")[0])
    # what is computed once is answered once more, and never anew
    answers = dict(rig.heard["/vo2/estimate"])
    assert len(set(rig.heard["/vo2/estimate"])) == len(answers)
    stamps = [stamp for stamp, _ in rig.heard["/vo2/estimate"]]
    assert stamps == sorted(stamps)
    assert {"vo2/estimator: late", "vo2/estimator: memory"} <= statuses
    places = np.array([stamp // MS - 1 for stamp in answers])
    found, bounds = np.array([[v[0], v[2]] for v in answers.values()]).T
    inside = np.mean(np.abs(found - true[places]) <= bounds)
    undisturbed = np.mean(np.abs(np.asarray(whole.deflection) - true) <= np.asarray(whole.bound))
    assert inside >= undisturbed, (inside, undisturbed)
    assert np.max(bounds) > 3.0 * np.max(np.asarray(whole.bound)), "the bound grows"
    # the ends of the major loop erase whatever was not seen
    last = slice(-10, None)
    np.testing.assert_allclose(found[last], np.asarray(whole.deflection)[last], atol=1e-12)
    np.testing.assert_allclose(bounds[last], np.asarray(whole.bound)[last], atol=1e-12)
