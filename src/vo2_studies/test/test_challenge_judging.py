"""Every scoring rule on diagnoses made by hand."""

import copy

import pytest
from vo2_studies.challenge.judging import FAILED, LIMIT, NONE, excess_removed, judge, ranking
from vo2_studies.challenge.parameters import QUANTITIES, compare_parameters, in_base_unit


def diagnosis(*ids, **changes):
    """Return a diagnosis that names `ids`, located in the deflection while heating."""
    plain = {
        "schema": "vo2-diagnosis/1",
        "verdict": "differs" if ids else "agrees",
        "location": [
            {"signal": "film_resistance", "share": 0.2, "branch": "both", "frequency_hz": [0.0, 5.0]},
            {"signal": "tip_deflection", "share": 0.8, "branch": "heating", "frequency_hz": [90.0, 110.0]},
        ],
        "effects": [{"id": name, "probability": 0.9, "parameters": {}} for name in ids],
        "candidates": [{"id": "creep", "probability": 0.1}, {"id": "dead_time", "probability": 0.6}],
        "fit": {"tip_deflection": {"nrmse_before": 0.05, "nrmse_after": 0.02, "noise_floor": 0.01}},
        "indistinguishable": [],
        "next_experiment": None,
    }
    return plain | changes


def effect(name, excess=50.0, **changes):
    plain = {
        "id": name,
        "signal": None,
        "parameters": {},
        "excess": excess,
        "channels": ["tip_deflection"],
        "branch": "both",
        "absorbed_by_constant": False,
    }
    return plain | changes


def judged(kind, effects, found, **result):
    answer = {"kind": kind, "device": "integrated", "effects": effects}
    return judge(answer, {"failure": "", "seconds": 3.0, "diagnosis": found, "follow_up": None} | result)


def test_no_effect():
    assert not judged("none", [], diagnosis()).alarm
    assert judged("none", [], diagnosis()).first == NONE
    assert judged("none", [], diagnosis("creep")).alarm
    # to say that something differs is an alarm too, named or not
    assert judged("none", [], diagnosis(verdict="differs")).alarm
    assert judged("none", [], diagnosis("unknown")).first == "unknown"


def test_verdicts_of_unchanged_and_drifted_devices():
    drifted = diagnosis(verdict="drifted", moved=[moved("thermal.ambient", 5.0)])
    assert not judged("day", [], drifted).alarm
    assert judged("day", [], drifted).verdict and judged("day", [], diagnosis()).verdict
    assert not judged("none", [], drifted).verdict
    assert not judged("day", [], diagnosis("creep")).verdict
    assert judged("one", [effect("creep")], diagnosis("creep")).verdict
    assert not judged("one", [effect("creep")], drifted).verdict


def moved(constant, sigmas):
    return {"constant": constant, "was": 20.0, "is": 20.0 + 0.1 * sigmas, "std": 0.1, "unit": "K"}


def test_moved_constants():
    def right(verdict, *entries, kind="moved"):
        answer = {
            "kind": kind,
            "device": "integrated",
            "effects": [effect("creep")] if kind == "beside" else [],
            "moved": [{"constant": "ambient", "by": 1.0, "unit": "K"}],
        }
        found = diagnosis(*(["creep"] if kind == "beside" else []), verdict=verdict, moved=list(entries))
        return judge(answer, {"diagnosis": found}).constant

    assert right("drifted", moved("thermal.ambient", 9.0))
    assert right("drifted", moved("thermal.time_constant", 2.0), moved("thermal.ambient", -9.0))
    assert not right("drifted", moved("thermal.time_constant", 9.0), moved("thermal.ambient", 2.0))
    assert not right("differs", moved("thermal.ambient", 9.0))
    assert not right("drifted")
    assert right("differs", moved("thermal.ambient", 9.0), kind="beside")
    # an answer of before there was `moved`
    plain = diagnosis(verdict="differs")
    answer = {"kind": "moved", "device": "x", "effects": [], "moved": [{"constant": "ambient"}]}
    assert judge(answer, {"diagnosis": plain}).constant is False


def test_the_interval_of_a_moved_constant():
    def holds(constant, by, unit, *entries):
        answer = {
            "kind": "moved",
            "device": "x",
            "effects": [],
            "moved": [{"constant": constant, "by": by, "unit": unit}],
        }
        found = diagnosis(verdict="drifted", moved=list(entries))
        return judge(answer, {"diagnosis": found}).constant_held

    room = moved("thermal.ambient", 10.0)  # 1.0 +- 0.1 K
    assert holds("ambient", 1.16, "K", room) and not holds("ambient", 1.17, "K", room)
    lag = {"constant": "thermal.time_constant", "was": 2e-3, "is": 2.2e-3, "std": 0.1e-3, "unit": "s"}
    assert holds("time_constant", 0.18, "1", room, lag) and not holds("time_constant", 0.19, "1", room, lag)
    assert holds("time_constant", 0.1, "1", room) is None  # not told
    zero = {"constant": "deflection.zero", "was": 0.0, "is": 1e-7, "std": 1e-9, "unit": "m"}
    assert holds("deflection_zero", 0.01, "of range", zero) is None


def test_families_and_siblings():
    truth = [effect("creep", families=["structure"], siblings=["log_creep"])]

    def named_as(name, **entry):
        found = diagnosis(name)
        found["effects"][0] |= entry
        return judged("one", truth, found)

    assert named_as("creep", family="structure").family
    assert named_as("creep").family, "the family of a name that comes without one"
    assert named_as("backlash").family and not named_as("backlash").top1
    assert not named_as("series_resistance").family
    assert named_as("unknown", family="structure").family
    assert not named_as("unknown").family
    # a form that another name says as much of
    other = named_as("log_creep")
    assert other.top1 and other.sibling and not other.wrong
    # siblings that the diagnosis itself tells
    told = named_as("backlash", siblings=["creep", "stiffening"])
    assert told.sibling and not told.top1 and told.wrong
    lag = [effect("sensor_lag", families=["sensor:tip_deflection"], signal="tip_deflection")]
    found = diagnosis("sensor_lag")
    assert not judged("one", lag, found).family
    found["effects"][0]["signal"] = "tip_deflection"
    assert judged("one", lag, found).family


def test_a_stated_set_is_right_only_where_it_holds_the_truth():
    def of(truth, *members, kind="one"):
        found = diagnosis("unknown")
        found["effects"][0] |= {"siblings": list(members), "family": "structure"}
        return judged(kind, [effect(truth, families=["structure"])], found)

    right = of("creep", "creep", "sensor_lag")
    assert right.sibling and right.family and not right.top1 and not right.wrong
    assert right.stated == ((0.9, True),)
    wrong = of("creep", "averaging", "sensor_lag")
    assert wrong.wrong and not wrong.sibling and wrong.stated == ((0.9, False),)
    outside = of("composed", "averaging", "sensor_lag", kind="outside")
    assert outside.wrong and not outside.unknown


def test_stated_probabilities_of_every_effect():
    found = diagnosis("creep", "dead_time")
    assert judged("one", [effect("creep")], found).stated == ((0.9, True), (0.9, False))
    assert judged("outside", [effect("composed")], diagnosis("unknown")).stated == ((0.9, True),)
    assert judged("one", [effect("creep")], diagnosis("unknown")).stated == ((0.9, False),)


def test_one_effect_first_and_among_three():
    right = judged("one", [effect("creep")], diagnosis("creep"))
    assert right.top1 and right.top3 and right.counted and right.first == "creep"
    second = judged("one", [effect("creep")], diagnosis("dead_time", "creep"))
    assert (second.top1, second.top3) == (False, True)
    candidate = judged("one", [effect("creep")], diagnosis("unknown"))
    assert (candidate.top1, candidate.top3) == (False, True)
    assert ranking(diagnosis("unknown")) == ["unknown", "dead_time", "creep"]
    absent = judged("one", [effect("latent_heat")], diagnosis("dead_time"))
    assert (absent.top1, absent.top3) == (False, False)


def test_a_candidate_of_a_diagnosis_that_agrees_is_no_answer():
    assert not judged("one", [effect("dead_time")], diagnosis()).top3


def test_weak_effects_are_not_counted():
    assert not judged("one", [effect("creep", excess=9.9)], diagnosis("creep")).counted
    assert not judged("two", [effect("creep", 50), effect("dead_time", 5)], diagnosis("creep")).counted


def test_absorbed_by_a_constant_counts_if_stated():
    laser = effect("laser_heating", absorbed_by_constant=True)
    silent = diagnosis("ambient_drift")
    assert not judged("one", [laser], silent).top1
    pair = diagnosis("ambient_drift", indistinguishable=[["ambient_drift", "laser_heating"]])
    found = judged("one", [laser], pair)
    assert found.top1 and found.top3 and found.limit
    assert judged("one", [laser], diagnosis("ambient_drift", not_excited=["laser_heating"])).top1
    assert judged("one", [laser], diagnosis("unknown", limits=["a steady laser_heating looks the same"])).top1
    # the matrix shows what counted: the limit, not the name beside it
    assert found.first == LIMIT
    unnamed = diagnosis(verdict="differs", not_excited=["laser_heating"])
    assert judged("one", [laser], unnamed).first == LIMIT
    # to agree is to have overlooked it, whatever the list of what is not excited says
    assert not judged("one", [laser], diagnosis(not_excited=["laser_heating"])).top1
    # a toggled laser is not absorbed: the mention does not count
    toggled = effect("laser_heating")
    assert not judged("one", [toggled], pair).top1


def test_missing_channel_counts_if_pair_and_manual_experiment_are_stated():
    truth = [effect("heater_tcr")]
    experiment = {
        "kind": "manual",
        "separates": ["nonlinear_heat_loss", "heater_tcr"],
        "excitation": None,
    }
    pair = [["heater_tcr", "nonlinear_heat_loss"]]
    full = diagnosis("nonlinear_heat_loss", indistinguishable=pair, next_experiment=experiment)
    assert judged("one", truth, full).top1
    assert not judged("one", truth, full | {"indistinguishable": []}).top1
    assert not judged("one", truth, full | {"next_experiment": None}).top1
    other = experiment | {"separates": ["nonlinear_heat_loss", "ambient_drift"]}
    assert not judged("one", truth, full | {"next_experiment": other}).top1
    playable = experiment | {"kind": "excitation", "excitation": {"levels_a": [1.0]}}
    assert not judged("one", truth, full | {"next_experiment": playable}).top1
    # an effect that no channel would separate gains nothing from it
    creep = diagnosis(
        "dead_time",
        indistinguishable=[["creep", "dead_time"]],
        next_experiment=experiment | {"separates": ["creep", "dead_time"]},
    )
    assert not judged("one", [effect("creep")], creep).top1


def test_excitation_is_scored_after_the_experiment():
    experiment = {
        "kind": "excitation",
        "separates": ["creep", "dead_time"],
        "excitation": {"levels_a": [1.0]},
    }
    first = diagnosis("dead_time", indistinguishable=[["creep", "dead_time"]], next_experiment=experiment)
    after = judged("one", [effect("creep")], first, follow_up=diagnosis("creep"))
    assert (after.top1, after.experiment, after.after_experiment) == (False, "excitation", True)
    wrong = judged("one", [effect("creep")], first, follow_up=diagnosis("dead_time"))
    assert wrong.after_experiment is False
    assert judged("one", [effect("creep")], first).after_experiment is None


def test_what_is_told_where_the_recording_does_not_separate():
    creep = [effect("creep")]
    assert judged("one", creep, diagnosis("creep")).told
    assert judged("one", creep, diagnosis("dead_time", indistinguishable=[["dead_time", "creep"]])).told
    assert judged("one", creep, diagnosis(not_excited=["creep"])).told
    assert judged("one", creep, diagnosis("dead_time")).told is False
    # a candidate is not told to be inseparable, and silence tells nothing
    assert judged("one", creep, diagnosis()).told is False
    assert judged("none", [], diagnosis()).told is None


def test_two_effects():
    truth = [effect("creep"), effect("dead_time")]
    both = judged("two", truth, diagnosis("dead_time", "creep"))
    assert (both.both, both.either, both.extra) == (True, True, False)
    half = judged("two", truth, diagnosis("dead_time", "latent_heat"))
    assert (half.both, half.either, half.extra) == (False, True, True)
    unsure = judged("two", truth, diagnosis("unknown"))
    assert (unsure.both, unsure.either, unsure.extra) == (False, False, False)
    three = judged("two", truth, diagnosis("dead_time", "creep", "latent_heat"))
    assert (three.both, three.extra) == (True, True)


def test_outside_the_catalogue():
    truth = [effect("mains_hum")]
    assert judged("outside", truth, diagnosis("unknown")).unknown
    assert not judged("outside", truth, diagnosis("creep")).unknown
    assert not judged("outside", truth, diagnosis("unknown", "creep")).unknown
    assert not judged("outside", truth, diagnosis()).unknown
    # located, not named, no catalogue name: the same answer in other form
    assert judged("outside", truth, diagnosis(verdict="differs")).unknown


def test_excess_removed():
    assert excess_removed(diagnosis("creep")) == pytest.approx(1 - (4 - 1) / (25 - 1))
    below = {"a": {"nrmse_before": 0.009, "nrmse_after": 0.02, "noise_floor": 0.01}}
    assert excess_removed({"fit": below}) is None
    two = {
        "a": {"nrmse_before": 0.02, "nrmse_after": 0.01, "noise_floor": 0.01},
        "b": {"nrmse_before": 2.0, "nrmse_after": 3.0, "noise_floor": 1.0},
    }
    assert excess_removed({"fit": two}) == pytest.approx(1 - 8 / 6)


def test_location():
    right = judged("one", [effect("creep", branch="heating")], diagnosis("creep"))
    assert right.channel and right.branch
    wrong = judged(
        "one", [effect("creep", channels=["film_resistance"], branch="cooling")], diagnosis("creep")
    )
    assert wrong.channel is False and wrong.branch is False
    assert judged("one", [effect("creep")], diagnosis("creep")).branch is None
    driver = {"signal": "heater_current", "share": 0.9, "branch": "both", "frequency_hz": [0.0, 5.0]}
    limited = effect("driver_saturation", branch="heating", channels=["tip_deflection", "heater_current"])
    found = diagnosis("driver_saturation")
    found["location"].append(driver)
    seen = judged("one", [limited], found)
    assert seen.channel and seen.branch
    assert judged("one", [limited], found | {"location": [driver]}).branch is False
    assert judged("one", [effect("creep")], diagnosis("creep", location=[])).channel is False


def test_resonance_frequency_by_parameter_or_band():
    def found(frequency, parameters=None, band=(90.0, 110.0)):
        truth = effect("cantilever_resonance", parameters={"frequency": {"value": frequency, "unit": "Hz"}})
        plain = copy.deepcopy(diagnosis("cantilever_resonance"))
        plain["location"][1]["frequency_hz"] = list(band)
        plain["effects"][0]["parameters"] = parameters or {}
        return judged("one", [truth], plain).frequency

    assert found(100.0)
    assert not found(120.0)
    assert found(120.0, {"f0": {"value": 0.121, "std": 0.001, "unit": "kHz"}})
    assert not found(120.0, {"f0": {"value": 130.0, "std": 1.0, "unit": "Hz"}})
    assert judged("one", [effect("creep")], diagnosis("creep")).frequency is None


def test_signal_of_a_sensor_effect():
    truth = effect("sensor_lag", signal="film_resistance")
    found = diagnosis("sensor_lag")
    found["effects"][0]["signal"] = "tip_deflection"
    assert judged("one", [truth], found).signal is False
    found["effects"][0]["signal"] = "film_resistance"
    assert judged("one", [truth], found).signal is True


def test_no_diagnosis_is_wrong_everywhere():
    one = judged("one", [effect("creep")], None, failure="diagnose: exit status 1")
    assert (one.top1, one.top3, one.channel, one.first) == (False, False, False, FAILED)
    assert one.failure == "diagnose: exit status 1"
    two = judged("two", [effect("creep"), effect("dead_time")], None)
    assert (two.both, two.either) == (False, False)
    assert judged("outside", [effect("mains_hum")], None).unknown is False


def test_parameters_are_compared_by_name_unit_and_sign():
    truth = {"delay": {"value": 2e-3, "unit": "s"}}
    good = compare_parameters("dead_time", truth, {"theta": {"value": 2.2, "std": 0.2, "unit": "ms"}})
    assert good.errors["delay"] == pytest.approx(0.1)
    assert good.covered["delay"] and not good.unmatched and not good.missing
    tight = compare_parameters("dead_time", truth, {"theta": {"value": 2.2, "std": 0.1, "unit": "ms"}})
    assert not tight.covered["delay"]
    by_unit = compare_parameters("dead_time", truth, {"whatever": {"value": 2e-3, "std": 0, "unit": "s"}})
    assert by_unit.errors["delay"] == 0
    other = compare_parameters("dead_time", truth, {"theta": {"value": 2e-3, "std": 0, "unit": "K"}})
    assert other.unmatched == ("theta",) and other.missing == ("delay",) and not other.errors
    shift = {"shift": {"value": -1.0, "unit": "K"}}
    signed = compare_parameters(
        "transition_offset", shift, {"delta": {"value": 1.0, "std": 0.1, "unit": "K"}}
    )
    assert signed.errors["shift"] == 2
    free = {"shift_per_reversal": {"value": -1.0, "unit": "K"}}
    loose = compare_parameters("training_drift", free, {"x": {"value": 1.0, "std": 0.1, "unit": "K"}})
    assert loose.errors["shift_per_reversal"] == 0


def test_one_of_two_ways_to_say_it_suffices():
    truth = {"resistance": {"value": 1e6, "unit": "ohm"}, "conductance": {"value": 1e-6, "unit": "S"}}
    found = compare_parameters(
        "leakage_resistance", truth, {"r_l": {"value": 1.1, "std": 0.1, "unit": "Mohm"}}
    )
    assert found.errors == {"resistance": pytest.approx(0.1)}
    assert not found.missing


def test_ambiguous_parameters_are_left_unmatched():
    truth = {"gain": {"value": 0.1, "unit": "1"}, "time_constant": {"value": 2.0, "unit": "s"}}
    found = {key: {"value": 1.0, "std": 0.1, "unit": "s"} for key in ("p", "q")}
    comparison = compare_parameters("second_thermal_mode", truth, found)
    assert set(comparison.unmatched) == {"p", "q"}
    assert set(comparison.missing) == {"gain", "time_constant"}


@pytest.mark.parametrize(
    ("text", "base", "factor"),
    [
        ("ms", "s", 1e-3),
        ("um/K", "m/K", 1e-6),
        ("µm/K", "m/K", 1e-6),
        ("%", "1", 0.01),
        ("kHz", "Hz", 1e3),
        ("degC", "K", 1.0),
        ("kohm", "ohm", 1e3),
        ("K/mA^2", "K/A^2", 1e6),
        ("K/A²", "K/A^2", 1.0),
        ("1/K", "1/K", 1.0),
        ("", "1", 1.0),
        ("mK", "K", 1e-3),
        ("K^(1-n)", "K^(1-n)", 1.0),
    ],
)
def test_units(text, base, factor):
    found, value = in_base_unit(text)
    assert found == base
    assert value == pytest.approx(factor)


def test_every_effect_of_the_catalogue_has_quantities_that_it_draws():
    import numpy as np
    from vo2_studies.challenge.catalogue import CATALOGUE, draw_effect
    from vo2_studies.challenge.devices import draw_device
    from vo2_studies.challenge.effect import Context

    assert {entry.id for entry in CATALOGUE} == set(QUANTITIES)
    for entry in CATALOGUE:
        device = draw_device(np.random.default_rng(1), entry.presets[0])
        drawn = draw_effect(entry, Context(np.random.default_rng(2), device, 10.0))
        for quantity in QUANTITIES[entry.id] if entry.form == "catalogue" else ():
            assert quantity.truth in drawn.parameters
            if quantity.unit:
                assert in_base_unit(drawn.parameters[quantity.truth][1])[0] == quantity.unit
