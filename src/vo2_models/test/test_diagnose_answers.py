"""What an answer says beside its name: of another device, of a second effect, of a family, of states nobody has seen."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from own_devices import STACK_TO_10_V as DEVICE
from vo2_models.device.description import preset
from vo2_models.diagnosis import decide, pipeline, report
from vo2_models.diagnosis import search as third_stage
from vo2_models.diagnosis.adequacy import Adequacy
from vo2_models.diagnosis.check import Unusable
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.nuisance import from_beyond
from vo2_models.diagnosis.pipeline import study
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.report import assemble_diagnosis
from vo2_models.diagnosis.result import MovedConstant
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import HEATER_CURRENT, TIP_DEFLECTION, Recording

LAW = PreisachOperator(np.linspace(0.0, 10.0, 21), 1e-7 * np.tril(np.ones((20, 20))))


def recorded(seed, low=0.0, high=10.0):
    """Loops of falling and rising size between two voltages, from rest at the lower one."""
    levels = np.random.default_rng(seed).uniform(size=60)
    levels[:4] = 0.0, 1.0, 0.0, 1.0
    levels[6::6] = 0.0
    share = np.interp(np.arange(900), np.arange(60) * 15.0, levels)
    volts = low + (high - low) * share
    noise = 2e-9 * np.random.default_rng(seed + 100).standard_normal(volts.size)
    channels = {HEATER_CURRENT: volts, TIP_DEFLECTION: LAW.run(volts) + noise}
    return Recording(0.1 * np.arange(volts.size), channels, "stack")


@pytest.fixture(scope="module")
def model():
    return fit_model([recorded(1, 0.0, 6.0)], DEVICE.key)[1]


@pytest.fixture(scope="module")
def found(model):
    return study([recorded(2, 0.0, 6.0)], model)


def with_body(found):
    nominal = found.located.problem.nominal
    of = replace(nominal, model=replace(nominal.model, device=preset("integrated").key))
    return replace(found, located=replace(found.located, problem=replace(found.located.problem, nominal=of)))


def test_a_state_from_beyond_the_range_lasts_until_the_other_end_is_reached():
    path = np.array([0.5, 1.0, 1.04, 0.5, 1.2, 0.6, 0.9, 0.05, 0.005, 0.5, -0.2, 0.5, 0.995, 0.5])
    beyond = from_beyond(path, 0.0, 1.0)
    assert np.flatnonzero(beyond).tolist() == [4, 5, 6, 7, 10, 11]
    assert not from_beyond(path[:4], 0.0, 1.0).any()


def test_what_comes_from_beyond_the_calibration_is_not_judged(model):
    wider = study([recorded(3, 0.0, 9.0)], model)
    (finding,) = [f for f in wider.reading.findings if "come from there" in f.text]
    assert finding.kind == "unjudged" and "beyond 0 to 6 V" in finding.text.replace("0.0", "0")
    assert assemble_diagnosis(wider).summary.startswith(finding.text)
    (part,) = wider.reading.parts
    volts = part.current
    assert not part.valid[TIP_DEFLECTION][volts > 6.4].any() and part.valid[TIP_DEFLECTION][volts < 6.4].any()
    with pytest.raises(
        Unusable, match=r"of 900 samples are beyond .* V, .*; fit a calibration that covers them"
    ):
        study([recorded(3, 9.0, 10.4)], model)


def test_within_the_calibration_nothing_is_left_out(found):
    assert not [f for f in found.reading.findings if "come from there" in f.text]


@pytest.mark.parametrize(
    ("moves", "verdict", "asked"),
    [
        ({"deflection.gain": 1.2, "thermal.time_constant": 1.1, "thermal.linear_gain": 0.9}, "drifted", True),
        ({"deflection.gain": 1.2, "thermal.time_constant": 1.1}, "drifted", False),
        ({"deflection.gain": 1.2, "thermal.time_constant": 1.1}, "differs", True),
        (
            {"deflection.gain": 1.02, "thermal.time_constant": 1.01, "thermal.linear_gain": 1.1},
            "drifted",
            False,
        ),
        (
            {"thermal.square_gain": 1.2, "thermal.time_constant": 1.1, "thermal.linear_gain": 0.9},
            "drifted",
            False,
        ),
    ],
)
def test_many_constants_far_off_at_once_raise_the_question_of_another_device(
    found, monkeypatch, moves, verdict, asked
):
    moved = [MovedConstant(name, 1.0, now, 1e-3, "1") for name, now in moves.items()]
    monkeypatch.setattr(report, "_moved", lambda study: moved)
    answer = replace(found, decision=replace(found.decision, verdict=verdict, chosen=None))
    said = report._device_in_words(answer)
    assert ("is it a recording of another device?" in said) is asked


@pytest.fixture
def of_two(found, monkeypatch):
    """A study whose answer is a and b, from the weights of pairs; b and lag are of a sensor, clock of its clock."""
    families = {"a": "film", "b": "sensor:x", "lag": "sensor:x", "clock": "clock:x", "heat": "heat"}
    candidates = tuple(
        SimpleNamespace(key=key, signal="", record=SimpleNamespace(family=lambda s, own=own: own))
        for key, own in families.items()
    )

    def answer(weights):
        pairs = [SimpleNamespace(keys=("a", other)) for other in weights]
        told = (pairs, np.array(list(weights.values())))
        monkeypatch.setattr(report, "_explanations", lambda study: told)
        monkeypatch.setattr(report, "_something_else", lambda study: 0.1)
        decision = replace(found.decision, chosen=SimpleNamespace(keys=("a", "b")))
        return replace(found, decision=decision, search=replace(found.search, candidates=candidates))

    return answer


@dataclass(frozen=True)
class Told:
    """An explanation of one effect without parameters."""

    keys: tuple[str, ...]
    chi_square: float
    gain: float
    coordinates: tuple = ()
    courses: dict = field(default_factory=dict)


@pytest.mark.parametrize(
    ("gain", "remaining", "apart"),
    # of few noise powers a share of the gain is the smaller measure, of many the samples that one loop is worth
    [(1.0, 0.0, 0.1), (100.0, 0.0, 0.25), (100.0, 3.0, 1.0)],
)
def test_on_one_loop_a_recording_is_worth_few_samples_however_long(found, gain, remaining, apart):
    count = found.located.problem.count
    decision = replace(found.decision, remaining_excess=remaining, rivals=())

    def ratio(device, reading):
        best, other = Told(("a",), count, gain * count), Told(("b",), (1.0 + apart) * count, gain * count)
        answer = replace(device, reading=reading, decision=replace(decision, chosen=best))
        weights = report._weights(answer, [best, other], [best.chi_square, other.chi_square])
        return weights[1] / weights[0]

    one_loop = replace(found.reading, one_loop=True)
    assert ratio(found, one_loop) == pytest.approx(np.exp(-1.0), rel=1e-3)
    assert ratio(found, replace(found.reading, one_loop=False)) < 0.1
    share = Limits().temper_on_one_loop * gain
    assert ratio(with_body(found), one_loop) == pytest.approx(np.exp(-0.5 * apart / share), rel=1e-3)


def test_one_of_two_that_is_less_likely_than_not_is_doubted(found, of_two):
    doubted = of_two({"b": 0.5, "heat": 0.5})
    assert report.doubts_one_of_two(doubted) and report.one_of_family(doubted) == {}
    named = of_two({"b": 0.6, "heat": 0.4})
    assert not report.doubts_one_of_two(named) and report.one_of_family(named) == {}
    assert not report.doubts_one_of_two(found)


def test_one_of_two_that_its_family_may_replace_is_told_as_one_of_them(of_two):
    answer = of_two({"b": 0.2, "lag": 0.45, "clock": 0.3, "heat": 0.05})
    assert not report.doubts_one_of_two(answer)
    assert report.one_of_family(answer) == {"b": ("lag", "clock", "b")}
    assert not report.unlikely(with_body(answer))


@pytest.mark.parametrize(("in_the_second", "acts"), [(30.0, True), (20.0, False), (-5.0, False)])
def test_a_second_effect_acts_in_each_recording_where_it_explains_a_part_of_each(found, in_the_second, acts):
    def option(keys, *by_part):
        final = SimpleNamespace(residual=np.zeros(2), chi_square_by_part=lambda vector: np.array(by_part))
        chosen = SimpleNamespace(keys=keys, deviation=np.zeros(2), courses={}, hypotheses=())
        return SimpleNamespace(chosen=chosen, final=final)

    both, alone = option(("a", "b"), 900.0, 1000.0), option(("b",), 2000.0, 1000.0 + in_the_second)
    other = option(("c",), 5000.0, 5000.0)
    searched = replace(found.search, options=(both, alone, other))
    answer = replace(found, search=searched, decision=replace(found.decision, chosen=both.chosen))
    assert pipeline._acts_in_each(answer) is acts
    assert not pipeline._acts_in_each(replace(answer, search=replace(searched, options=(both, other))))
    assert not pipeline._acts_in_each(replace(answer, decision=replace(answer.decision, chosen=alone.chosen)))
    both.chosen.hypotheses = (SimpleNamespace(switches=("start", "stop")),)
    assert not pipeline._acts_in_each(answer)


@pytest.mark.parametrize(
    ("share", "sigmas", "near"), [(0.92, 30.0, True), (0.3, 30.0, False), (0.92, 5.0, False)]
)
def test_what_surely_explains_most_is_said_where_nothing_is_named(found, share, sigmas, near):
    adequacy = Adequacy(("creep", "sensor_lag:x"), share, 2.0, sigmas)
    said = report._nearest_name(replace(found, decision=replace(found.decision, adequacy=adequacy)))
    assert said.startswith("No name is sure: creep with sensor_lag would explain 92 %") is near
    assert (said == "Nothing known explains it") is not near
    if near:  # what leaves nothing is not refused for what it leaves
        little = replace(adequacy, left=0.0)
        answer = replace(found, decision=replace(found.decision, adequacy=little))
        assert "leaves more than a name may" in said
        assert "others fit as well" in report._nearest_name(answer)


@pytest.mark.parametrize(("beyond", "said"), [(0.5, "1.5 times the power of "), (-0.04, "no more than ")])
def test_a_channel_with_no_more_than_is_expected_is_not_so_many_times_it(found, beyond, said):
    assert report._times_the_floor(found, beyond) == said + report._floor(found)


@pytest.mark.parametrize(
    ("keys", "said"),
    [(("b", "lag"), "All are"), (("b", "lag", "heat"), "Most are"), (("b", "heat"), "The likeliest is")],
)
def test_how_many_of_a_set_are_of_its_family_is_said(of_two, keys, said):
    answer = with_body(of_two({"b": 1.0}))
    answer = replace(answer, decision=replace(answer.decision, equivalent=keys))
    assert report._share_of_family(answer, "sensor:x") == said


def verdict(keys, remaining):
    return SimpleNamespace(
        option=SimpleNamespace(chosen=SimpleNamespace(keys=keys), remaining=remaining), remaining=remaining
    )


def test_a_name_takes_a_second_with_it_that_explains_most_of_what_it_leaves():
    single, limits = verdict(("a",), 4.0), Limits()
    most, little, others = verdict(("a", "b"), 1.0), verdict(("a", "c"), 3.0), verdict(("b", "c"), 0.5)
    assert decide._with_its_second(single, [little, most, others], limits) is most
    assert decide._with_its_second(single, [little, others], limits) is single
    assert decide._with_its_second(others, [most], limits) is others


@pytest.mark.parametrize(
    ("gain", "elsewhere", "like"), [(300.0, 0.8, True), (300.0, 0.2, False), (5000.0, 8.0, False)]
)
def test_no_weak_name_beside_more_in_a_channel_that_it_does_not_reach(monkeypatch, gain, elsewhere, like):
    monkeypatch.setattr(decide, "reached", lambda option: {"x"})
    final = SimpleNamespace(count_by_channel={"x": 1000.0, "y": 1000.0})
    option = SimpleNamespace(final=final, chosen=SimpleNamespace(gain=gain))
    adequacy = Adequacy(("creep",), 1.0, 0.0, 20.0, elsewhere=elsewhere)
    assert decide._like_the_rest(option, adequacy, Limits()) is like


def test_recordings_share_a_chi_square(found):
    problem = found.located.problem
    parts = problem.chi_square_by_part(problem.residual)
    assert parts.shape == (1,) and parts[0] == pytest.approx(problem.residual_chi_square)


@pytest.mark.parametrize(
    ("shares", "family"),
    [({"film": 0.6, "heat": 0.3}, "film"), ({"film": 0.6, "heat": 0.4}, ""), ({"film": 0.45}, "")],
)
def test_what_has_no_name_is_of_the_family_that_explains_clearly_most(found, monkeypatch, shares, family):
    singles = tuple(
        SimpleNamespace(
            hypotheses=(SimpleNamespace(record=SimpleNamespace(family=lambda s, own=own: own), signal=""),),
            gain=share,
        )
        for own, share in shares.items()
    )
    monkeypatch.setattr(report, "_share", lambda study, gain: gain)
    searched = replace(found, search=replace(found.search, singles=singles))
    assert report._family_of_the_best(with_body(searched)) == family
    assert report._family_of_the_best(searched) == "", "of one loop neither film nor heat can be told"


@pytest.mark.parametrize("sigmas", [100.0, np.inf])
@pytest.mark.parametrize("left", [0.0, 1e6])
def test_no_answer_is_surer_than_such_answers_were_unless_the_values_show_it(found, sigmas, left):
    adequacy = Adequacy(("creep",), 1.0, left, sigmas)
    told = report._something_else(replace(found, decision=replace(found.decision, adequacy=adequacy)))
    least = found.limits.else_least
    assert (least <= told <= 1.0 - least) is bool(np.isfinite(sigmas) or left == 0.0)


@pytest.mark.parametrize("leaves", [0.5, 9.0])
def test_a_course_is_compared_with_another_beside_the_partner(found, monkeypatch, leaves):
    """Of two courses the one that is worse alone may be right once the second effect is there."""

    def single(key, gain):
        record = SimpleNamespace(takes_course=True)
        return SimpleNamespace(
            keys=(key,), gain=gain, chi_square=100.0 - gain, at_bound=(), courses={key: None},
            hypotheses=(SimpleNamespace(record=record),), cornered=False,
        )  # fmt: skip

    def option(chosen, remaining=50.0):
        return SimpleNamespace(chosen=chosen, remaining=remaining)

    def paired(nominal, problem, alone, *others, **more):
        ours = alone.chosen.keys[0] == "drive_gain_drift"
        both = SimpleNamespace(keys=(*alone.chosen.keys, "averaging"), chi_square=leaves if ours else 2.0)
        return option(both, leaves if ours else 0.0)

    singles = [single("drive_gain_drift", 40.0), single("ambient_drift", 30.0)]
    monkeypatch.setattr(third_stage, "_best_inside", lambda singles, limits: singles[0])
    monkeypatch.setattr(third_stage, "option_of", lambda nominal, problem, one, *others, **more: option(one))
    monkeypatch.setattr(third_stage, "_in_one_switch", lambda located, alone, *others: alone)
    monkeypatch.setattr(third_stage, "_partner_alone", lambda *others: [])
    monkeypatch.setattr(third_stage, "_late_for_one_reason", lambda *others: None)
    monkeypatch.setattr(third_stage, "pair_of", paired)
    monkeypatch.setattr(third_stage, "cost", lambda one, problem, limits: one.chi_square)
    quiet = replace(found.located, own_misfit={})
    first, *_ = third_stage._options(
        quiet, singles, [], replace(found.limits, gain=0.0, slack=1.0), Clock(lambda *told: None, 1)
    )
    assert first.chosen.keys[0] == ("ambient_drift" if leaves > 1.0 else "drive_gain_drift")


def test_a_move_of_a_device_that_is_not_heated_is_told_of_its_drive_and_its_response(found):
    def said(constant, now):
        return report._as_drive(found, MovedConstant(constant, 2.0, now, 0.1, "1"))

    assert said("thermal.linear_gain", 1.8) == " (the drive is 0.9 times what it was)"
    assert said("deflection.gain", 1.8) == " (tip_deflection is 0.9 times what it was)"
    assert said("thermal.time_constant", 1.8) == ""
    assert said("deflection.gain", 1.8) and not report._as_drive(
        with_body(found), MovedConstant("deflection.gain", 2.0, 1.8, 0.1, "1")
    )
