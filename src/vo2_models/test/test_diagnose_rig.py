"""Diagnosis of a device without body: its own misfit is the yardstick; few, jittered and unstamped samples are judged."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from own_devices import STACK_TO_10_V as DEVICE
from scipy.signal import lfilter, lsim
from vo2_models.device.description import described, preset
from vo2_models.device.model import DeviceModel
from vo2_models.diagnosis import decide, hypotheses, report
from vo2_models.diagnosis import search as third_stage
from vo2_models.diagnosis.adequacy import Adequacy, adequacy_of, shown
from vo2_models.diagnosis.corrected_model import corrected_model
from vo2_models.diagnosis.drift import drift_of
from vo2_models.diagnosis.explain import either_way, fit_jointly
from vo2_models.diagnosis.families import BY_DEPENDENCE, family_of_unnamed
from vo2_models.diagnosis.held_out import block_folds
from vo2_models.diagnosis.hypotheses import _late, _lateness
from vo2_models.diagnosis.loop_shape import loop_shapes
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.nonparametric_correction import Shape, fit_nonparametric_correction
from vo2_models.diagnosis.page import report_page
from vo2_models.diagnosis.pipeline import study
from vo2_models.diagnosis.progress import Clock
from vo2_models.diagnosis.report import assemble_diagnosis, moved_in_place
from vo2_models.diagnosis.result import MovedConstant
from vo2_models.hysteresis.preisach import PreisachOperator
from vo2_models.identification.bank_fit import BankShape
from vo2_models.identification.calibration_check import check_calibration
from vo2_models.identification.model_fit import fit_model
from vo2_models.prediction import predict
from vo2_models.recording import HEATER_CURRENT, RESISTANCE, TIP_DEFLECTION, Recording

HIGH, LOW = np.tril_indices(40)
MIDDLE = np.exp(
    -0.5 * ((HIGH + LOW - 40) / 20) ** 2
)  # loops differ along the drive, so that no few plays describe them
LAW = PreisachOperator(np.linspace(0.0, 10.0, 41), MIDDLE * np.exp(-0.5 * ((HIGH - LOW - 5) / 4) ** 2) * 1e-7)
SIZE = 900


def recorded(
    seed: int, every: int = 1, jitter: float = 0.0, cycles: int = 9, change=lambda y: y
) -> Recording:
    """Loops of falling size, in another order of amplitudes for each seed, with slow misfit that no law has."""
    rng = np.random.default_rng(seed)
    time = np.arange(SIZE) * 0.1
    size = np.interp(np.arange(SIZE), np.linspace(0, SIZE, 7), 5.0 * rng.permutation(np.linspace(0.4, 1, 7)))
    size[: SIZE // 6] = 5.0
    volts = 5.0 - size * np.cos(2 * np.pi * cycles * time / time[-1])
    stroke = LAW(volts)
    wander = np.interp(time, np.linspace(0, time[-1], 12), rng.standard_normal(12))
    stroke = change(stroke) + np.ptp(stroke) * (4e-3 * wander + 5e-4 * rng.standard_normal(SIZE))
    stamps = time + jitter * rng.uniform(-0.1, 0.1, SIZE)
    channels = {HEATER_CURRENT: volts[::every], TIP_DEFLECTION: stroke[::every]}
    return Recording(stamps[::every], channels, "stack")


@pytest.fixture(scope="module")
def model():
    return fit_model([recorded(1)], DEVICE.key)[1]


@pytest.fixture(scope="module")
def unchanged(model):
    return study([recorded(2)], model)


@pytest.fixture(scope="module")
def lagging(model):
    """Of a sensor that lags by 3.5 samples."""
    return study([recorded(2, change=lambda y: y[0] + lfilter([0.25], [1, -0.75], y - y[0]))], model)


@pytest.mark.parametrize(
    ("given", "finding"),
    [({}, ""), ({"every": 15, "cycles": 2}, "few"), ({"jitter": 0.3}, "jitter")],
    ids=str,
)
def test_an_unchanged_device_agrees_and_nothing_is_named(model, given, finding):
    found = study([recorded(2, **given)], model)
    assert found.decision.verdict == "agrees" and found.decision.chosen is None
    assert not assemble_diagnosis(found).effects
    assert max(found.located.own_misfit.values()) < found.limits.own_misfit
    told = assemble_diagnosis(found).summary
    assert "could not be judged" not in told and "tip_deflection" not in told
    assert not finding or finding in [f.kind for f in found.reading.findings]


@pytest.mark.parametrize(("said", "noted"), [("stack", 0), ("/rig/stack_of_may.yaml", 0), ("press", 1)])
def test_a_calibration_says_of_which_device_it_is(said, noted):
    """A node that was given the path of a device file says the path: what that held then is not known."""
    notes = check_calibration([replace(recorded(1), device=said)], DEVICE.key)[1]
    assert len([note for note in notes if f"says that it is of device {said}" in note]) == noted


def test_what_is_far_from_the_model_as_it_is_does_not_agree_though_constants_and_loops_take_it_up(
    model, unchanged
):
    judged = unchanged.decision.judged
    far = judged.before[TIP_DEFLECTION] / judged.floor[TIP_DEFLECTION]
    assert unchanged.decision.taken_up == {} and far < unchanged.limits.as_it_is
    found = study([recorded(2)], model, limits=replace(unchanged.limits, as_it_is=0.9 * far))
    answer = assemble_diagnosis(found)
    assert answer.verdict == "differs" and answer.moved == []
    assert [effect.id for effect in answer.effects] == ["unknown"]
    assert f"misses it by {far:.2g} times" in answer.summary


@pytest.mark.parametrize(
    ("excess", "channel", "left_out", "own", "why"),
    [
        (0.1, 0.2, 0.0, 9.0, "no more than an unchanged device shows"),
        (0.1, 0.2, 0.0, 1.5, "1.5 times the error of the fit on held-out parts of its calibration, as repeats may be"),
        (0.6, 0.6, 0.0, 1.5, "1.5 times the error of the fit on held-out parts of its calibration, as repeats may be"),
        (0.6, 0.6, 0.0, 2.5, "parts of its calibration, more than most repeats, but no effect is adequate"),
        (0.6, 0.6, 0.7, 9.0, "miss of a stretch of their calibration that was left out, 70 %"),
        (0.3, 1.2, 0.5, 9.0, "miss of a stretch of their calibration that was left out, 50 %"),
    ],
)  # fmt: skip
def test_agreement_says_what_the_residual_is_measured_by(unchanged, excess, channel, left_out, own, why):
    located = replace(
        unchanged.located,
        total_excess=excess,
        excess={TIP_DEFLECTION: channel},
        left_out=left_out,
        own_misfit={TIP_DEFLECTION: own},
    )
    for verdict in ("agrees", "drifted"):
        decision = replace(unchanged.decision, verdict=verdict, chosen=None, unlike_noise=False)
        told = report._summary(replace(unchanged, located=located, decision=decision), [], [])
        assert (
            f"the residual exceeds {report._floor(unchanged)} by {100 * excess:.0f} % of its power, " in told
        )
        assert told.endswith(f"{why}.")


@pytest.mark.parametrize(
    ("share", "floor"), [(1.0, "the noise"), (0.5, "noise and misfit of the calibration")]
)
def test_what_is_taken_for_noise_may_hold_what_the_fit_missed(unchanged, share, floor):
    located = unchanged.located
    level = located.nominal.noise[TIP_DEFLECTION].level
    sensor = replace(located.nominal.model.sensors[TIP_DEFLECTION], noise=share * level)
    model = replace(located.nominal.model, sensors={TIP_DEFLECTION: sensor})
    found = replace(unchanged, located=replace(located, nominal=replace(located.nominal, model=model)))
    assert report._floor(found) == floor


@pytest.mark.parametrize(("sigmas", "told"), [(31.0, True), (9.0, False)])
def test_beside_agreement_an_effect_that_surely_acts_is_mentioned(unchanged, sigmas, told):
    adequacy = Adequacy(("source_compression",), 0.08, 1.7, sigmas)
    for verdict in ("agrees", "drifted"):
        decision = replace(
            unchanged.decision, verdict=verdict, chosen=None, unlike_noise=True, adequacy=adequacy
        )
        answer = report.assemble_diagnosis(replace(unchanged, decision=decision))
        said = "source_compression would explain 8 % of the excess, by 31 standard deviations"
        assert any(said in limit for limit in answer.limits) == told
        assert answer.effects == []
        assert ("no effect of the catalogue" in answer.summary) != told


@pytest.mark.parametrize("samples", [1.0, 7.0, 7.4])
def test_a_drive_that_comes_late_is_a_response_that_comes_late(model, samples):
    """On one response they are the same numbers, of a drive that jumps too, and no answer may choose between them."""
    nominal = Nominal.from_parameters(model)
    volts, dt = np.repeat(np.random.default_rng(3).uniform(0.0, 10.0, 40), 20), 0.1
    late = {"delay": samples * dt}
    clock = {f"clock_offset:{TIP_DEFLECTION}": {**late, "signal": TIP_DEFLECTION, "sampled": 1.0}}
    found = [
        nominal.respond(volts, dt, effects=effects, settled=True).channels[TIP_DEFLECTION]
        for effects in ({"dead_time": late}, clock, {})
    ]
    assert np.allclose(found[0], found[1], rtol=0.0, atol=1e-6 * np.ptp(found[2]))
    assert np.std(found[0] - found[2]) > 0.05 * np.ptp(found[2])


def test_an_excess_that_nothing_predicts_has_no_family(unchanged):
    unnamed = SimpleNamespace(share=0.1)
    decision = replace(unchanged.decision, verdict="differs", chosen=None, unnamed=unnamed)
    told = report._summary(
        replace(unchanged, decision=decision), [SimpleNamespace(id="unknown", family="heat", siblings=[])], []
    )
    assert "no smooth function of time, temperature, rate, current or memory predicts 25 %" in told
    assert "heat" not in told
    described = replace(decision, unnamed=SimpleNamespace(share=0.8))
    told = report._summary(
        replace(unchanged, decision=described),
        [SimpleNamespace(id="unknown", family="heat", siblings=[])],
        [],
    )
    assert "it acts in the family heat. A correction without a name removes 80 %" in told


def test_a_mode_that_the_model_has_is_tried_at_other_frequencies(unchanged):
    """Not at its own: that is the device, as it stands in the model."""
    problem = unchanged.located.problem
    has = {"share": 1.0, "frequency": 0.8, "damping": 0.1}
    known = replace(problem.nominal.model, effects={"cantilever_resonance": has})
    changed = replace(problem, nominal=replace(problem.nominal, model=known))
    found = {h.key: h for h in hypotheses.hypotheses(changed, DEVICE.key, problem.residual)}
    starts = found["cantilever_resonance"].starts
    assert {start["frequency"] for start in starts} == {0.8, *(0.8 * by for by in hypotheses.MOVED)}
    assert has not in starts


@pytest.mark.slow
def test_a_device_whose_loops_relax_agrees_and_has_no_second_relaxation():
    """What the fit found is part of the device: it comes to rest with it, and a slower sensor is another thing."""

    def relaxing(seed, slow=0.0):
        rng = np.random.default_rng(seed)
        volts = np.repeat(rng.uniform(0.0, 10.0, 90), 10)
        stroke = LAW(volts)
        for lag in (4.0, slow):
            keep = np.exp(-1.0 / lag) if lag else 0.0
            stroke = lfilter([1 - keep], [1, -keep], stroke, zi=[keep * stroke[0]])[0]
        stroke += np.ptp(stroke) * 2e-3 * rng.standard_normal(volts.size)
        return Recording(
            0.1 * np.arange(volts.size), {HEATER_CURRENT: volts, TIP_DEFLECTION: stroke}, "stack"
        )

    model = fit_model([relaxing(1)], DEVICE.key)[1]
    nominal, later = Nominal.from_parameters(model), relaxing(2)
    assert list(nominal.model.effects) == ["transition_kinetics"]
    told = nominal.respond(later[HEATER_CURRENT], 0.1, settled=True).channels[TIP_DEFLECTION]
    simulated = nominal.model.simulate(later[HEATER_CURRENT], dt=0.1, noise=False, settled=True)
    assert np.allclose(told, simulated[TIP_DEFLECTION], atol=1e-6 * np.ptp(told))
    assert study([later], model).decision.verdict == "agrees"
    found = study([relaxing(2, slow=2.0)], model)
    assert found.decision.verdict == "differs"
    assert "transition_kinetics" not in [one.key for one in found.search.candidates]
    (named,) = assemble_diagnosis(found).effects
    assert "sensor_lag" in (named.id, *named.siblings)


@pytest.mark.slow
def test_a_large_change_differs(model):
    span = np.ptp(recorded(2)[TIP_DEFLECTION])
    found = study([recorded(2, change=lambda y: np.minimum(y, y.max() - 0.3 * span))], model)
    assert found.decision.verdict == "differs"
    assert "most in stroke" in assemble_diagnosis(found).summary
    assert found.located.own_misfit[TIP_DEFLECTION] > found.limits.own_misfit


def test_a_name_must_be_more_likely_than_everything_else_together(unchanged, monkeypatch):
    """Without body no rival is told beside a name: one that is as likely as another is none."""
    found = unchanged
    named = replace(
        found, decision=replace(found.decision, chosen=SimpleNamespace(keys=("cantilever_resonance",)))
    )
    monkeypatch.setattr(report, "_something_else", lambda study: 0.1)

    def says(likely: float, device=DEVICE) -> bool:
        monkeypatch.setattr(report, "_candidates", lambda study: ([], {"cantilever_resonance": likely}))
        nominal = named.located.problem.nominal
        of = replace(nominal, model=replace(nominal.model, device=device.key))
        problem = replace(named.located.problem, nominal=of)
        return report.unlikely(replace(named, located=replace(named.located, problem=problem)))

    assert says(0.45) and says(0.5) and not says(0.51)
    # a device with a body tells the rivals of a name, and the experiment that separates them
    assert not says(0.45, preset("integrated")) and says(0.05, preset("integrated"))


def test_effects_that_explain_as_much_are_told_as_a_set_without_a_name(lagging):
    """A sensor that lags, on one response: others fit as well, and the answer holds it without naming one."""
    found = lagging
    answer = assemble_diagnosis(found)
    (effect,) = answer.effects
    assert effect.id == "unknown" and len(effect.siblings) > 1 and "sensor_lag" in effect.siblings
    assert effect.family == "sensor:stroke"
    assert answer.to_dict()["effects"][0]["siblings"] == effect.siblings
    assert f"one of {', '.join(effect.siblings)}" in answer.summary
    assert {pair[1] for pair in answer.indistinguishable} < set(effect.siblings)
    assert effect.probability > 0.5
    # beside the law's misfit a second effect is never named, and none is looked for
    assert [len(option.chosen.keys) for option in found.search.options] == [1]


@pytest.mark.slow
def test_a_creep_on_top_is_found_and_what_the_law_misses_does_not_speak_against_it(model):
    pole = np.exp(-0.1 / 6.0)

    def creeping(y):
        return y + 0.34 * lfilter([1 - pole], [1, -pole], y - y[0])

    found = study([recorded(3, change=creeping)], model)
    (effect,) = assemble_diagnosis(found).effects
    assert "creep" in (effect.id, *effect.siblings)
    option = found.search.options[0]
    assert option.chosen.keys == ("creep",) and not option.chosen.at_bound
    strict, lenient = (replace(found.limits, own_misfit=times) for times in (0.0, 1e6))
    assert adequacy_of(option, lenient).left == 0.0 < adequacy_of(option, strict).left
    # a share of what moved constants would explain as well is not forgiven
    forgiving = replace(strict, equation=1.0)
    assert adequacy_of(option, forgiving).left == 0.0 < adequacy_of(option, forgiving, most=0.0).left
    problem = found.located.problem
    hypothesis = next(one for one in found.search.candidates if one.key == "creep")
    stuck = fit_jointly(
        problem, [hypothesis], [{"share": 0.1, "time_constant": 6.0, "gain": 0.3}], found.limits, iterations=0
    )
    freed = either_way(problem, replace(stuck, at_bound=("creep.gain",)), found.limits)
    assert freed.chi_square < stuck.chi_square and not freed.at_bound and "gain" not in freed.values[0]


@pytest.mark.slow
def test_what_the_law_misses_in_a_few_places_is_no_sign_of_something_else(model):
    """As small loops that are none of its kind: a twelfth of the range for a tenth of the time, beside an effect and alone."""
    span, time = np.ptp(recorded(2)[TIP_DEFLECTION]), np.arange(SIZE) * 0.1
    missed = 0.08 * span * sum(np.exp(-((time - at) ** 2)) for at in (22.0, 51.0, 74.0))
    found = study([recorded(2, change=lambda y: y * np.linspace(1.0, 1.3, SIZE) + missed)], model)
    (effect,) = assemble_diagnosis(found).effects
    assert effect.id == "sensor_gain_drift"
    option = found.search.options[0]
    everywhere = replace(found.limits, told=0.999)
    assert adequacy_of(option, everywhere).left > 10.0 > 1.0 > adequacy_of(option, found.limits).left
    assert "It is judged by the 75 % of the samples" in assemble_diagnosis(found).summary
    alone = study([recorded(2, change=lambda y: y + missed)], model)
    assert alone.located.own_misfit[TIP_DEFLECTION] > found.limits.unlike_misfit
    assert not [e for e in assemble_diagnosis(alone).effects if e.id != "unknown"]


def _shape(group: str) -> Shape:
    return Shape(TIP_DEFLECTION, group, group, 1.0, 1.0)


def test_an_unnamed_effect_has_no_family_that_the_device_has_not(unchanged):
    """Of a loop and its one sensor neither structure nor film can be told; of a device whose file tells a structure it can."""
    found = unchanged
    problem, excess = found.located.problem, {TIP_DEFLECTION: 9.0}
    groups = [*BY_DEPENDENCE[TIP_DEFLECTION], "time and value"]
    families = {group: family_of_unnamed(problem, excess, [_shape(group)]) for group in groups}
    assert set(families.values()) == {f"sensor:{TIP_DEFLECTION}", "transition", "drive"}
    assert families["time and value"] == f"sensor:{TIP_DEFLECTION}"
    assert family_of_unnamed(problem, excess, []) == "transition"
    beam = described({**json.loads(DEVICE.document), "structure": {"length": 4e-4}}, "beam")
    nominal = replace(problem.nominal, model=replace(problem.nominal.model, device=beam.key))
    assert family_of_unnamed(replace(problem, nominal=nominal), excess, []) == "structure"


@pytest.mark.slow
def test_a_gain_that_walks_is_the_sensor_s(model):
    """With one response a drift of its sensor shows as time and its own value, whatever the loop does there."""
    walking = recorded(2, change=lambda y: y * np.linspace(1.0, 1.3, y.size))
    found = study([walking], model)
    problem = found.located.problem
    folds = block_folds(problem)
    shapes = fit_nonparametric_correction(problem, found.located.remaining, folds, found.limits).shapes
    assert shapes[0].group == "time and value" and shapes[0].share > 5.0 * shapes[1].share
    assert family_of_unnamed(problem, found.located.excess, shapes) == f"sensor:{TIP_DEFLECTION}"
    (effect,) = assemble_diagnosis(found).effects
    assert effect.id == "sensor_gain_drift" and effect.family == "sensor:stroke"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("of_response", "of_drive", "of_time"),
    [(1e9, 1e3, 1e-4), pytest.param(1e-3, 1e-4, 1e4, marks=pytest.mark.slow)],
    ids=str,
)
def test_units_and_sizes_change_nothing(model, of_response, of_drive, of_time):
    """Pascals or micrometres, hours or microseconds: a ripple of the same share of the range is the same one."""

    def rippled(y):
        return y + 0.04 * np.ptp(y) * np.sin(2.0 * np.pi * y / (0.15 * np.ptp(y)))

    def resized(recording):
        channels = {
            HEATER_CURRENT: of_drive * recording[HEATER_CURRENT],
            TIP_DEFLECTION: of_response * recording[TIP_DEFLECTION],
        }
        return Recording(of_time * recording.time_s, channels, device.key)

    document = json.loads(DEVICE.document)
    for key in ("limits", "operating"):
        document["drive"][key] = [of_drive * value for value in document["drive"][key]]
    document["responses"] = {"stroke": {"unit": "A/m"}}
    device = described(document, "stack")
    other = fit_model([resized(recorded(1))], device.key)[1]
    plain, there = (
        study([recorded(2, change=rippled)], model),
        study([resized(recorded(2, change=rippled))], other),
    )
    (effect,) = (answer := assemble_diagnosis(there)).effects
    assert effect.id == "sensor_ripple" and effect.parameters["pitch"].unit == "A/m"
    # what is named is in the file, were it next to nothing of the residual
    written = corrected_model(replace(there, limits=replace(there.limits, worth=1.0))).parameters
    assert any("sensor_ripple" in key for key in DeviceModel.from_parameters(written).effects)
    assert "sensor_ripple on stroke" in answer.summary
    shown = report_page(there, answer)
    assert "stroke / A/m" in shown and "deflection / um" not in shown and "film temperature" not in shown
    assert there.decision.chosen.gain == pytest.approx(plain.decision.chosen.gain, rel=1e-3)
    pitch, same = (one.decision.chosen.values[0]["pitch"] for one in (plain, there))
    assert same == pytest.approx(of_response * pitch, rel=1e-4)


@pytest.mark.slow
def test_what_leaves_more_than_any_unchanged_device_is_no_rival(model):
    """Of a loop without a memoryless part, a slow sensor is what a slow transition is; an average of its output is not."""
    rng = np.random.default_rng(3)
    volts = np.interp(np.arange(SIZE), np.arange(0, SIZE + 1, 25), rng.uniform(0.0, 10.0, SIZE // 25 + 1))
    keep = np.exp(-1.0 / 5.0)
    stroke = LAW(volts)
    stroke = lfilter([1 - keep], [1, -keep], stroke, zi=[keep * stroke[0]])[0]
    stroke += np.ptp(stroke) * 5e-4 * rng.standard_normal(SIZE)
    found = study(
        [Recording(0.1 * np.arange(SIZE), {HEATER_CURRENT: volts, TIP_DEFLECTION: stroke}, "stack")], model
    )
    (effect,) = assemble_diagnosis(found).effects
    assert sorted(effect.siblings) == ["sensor_lag", "transition_kinetics"]
    gains = {one.hypotheses[0].record.id: one.gain for one in found.search.singles}
    assert gains["averaging"] > found.limits.rival_of_misfit * gains["sensor_lag"]


@pytest.mark.slow
def test_one_that_leaves_less_than_its_rivals_by_many_deviations_is_named_alone(model):
    """Under fast random steps an average over six samples is no lag; what an unchanged device may show is no reason to say so."""
    rng = np.random.default_rng(4)
    volts = np.repeat(rng.uniform(0.0, 10.0, SIZE // 6), 6)
    exact = np.convolve(np.pad(LAW(volts), (5, 0), mode="edge"), np.full(6, 1 / 6), mode="valid")
    stroke = exact + np.ptp(exact) * 5e-4 * rng.standard_normal(SIZE)
    found = study(
        [Recording(0.1 * np.arange(SIZE), {HEATER_CURRENT: volts, TIP_DEFLECTION: stroke}, "stack")], model
    )
    answer = assemble_diagnosis(found)
    assert [(e.id, e.siblings) for e in answer.effects] == [("averaging", [])]
    assert answer.effects[0].probability > found.limits.credible
    assert answer.indistinguishable == [] and answer.next_experiment is None


def test_of_several_one_is_told_only_where_it_holds_most_of_the_probability(lagging, monkeypatch):
    several = lagging.decision.equivalent
    assert len(several) > 1 and lagging.decision.rival_pairs

    def says(likely: float) -> tuple[str, ...]:
        keys = lagging.decision.chosen.keys
        monkeypatch.setattr(report, "_candidates", lambda study: ([], {keys[0]: likely}))
        return report.equally_likely(lagging)

    assert says(0.95) == () and says(0.85) == several
    alone = decide.told_as(lagging.decision, ())
    assert alone.equivalent == () and alone.rival_pairs == () and alone.proposal is None
    assert decide.told_as(lagging.decision, several).rival_pairs == lagging.decision.rival_pairs


def test_of_a_set_no_member_is_the_answer_and_no_other_effect_is_told_beside_it(lagging):
    further = (*lagging.decision.rival_pairs, (lagging.decision.rival_pairs[0][0], "creep"))
    found = replace(lagging, decision=replace(lagging.decision, rival_pairs=further))
    answer = assemble_diagnosis(found)
    (effect,) = answer.effects
    assert {name for pair in answer.indistinguishable for name in pair} == set(effect.siblings)
    for one in answer.candidates:
        assert one.why_not and ("one of the set" in one.why_not) is (one.id in effect.siblings)
    (unknown,) = (one for one in answer.candidates if one.id == "unknown")
    assert "in no catalogue" in unknown.why_not
    page = report_page(found, answer)
    assert f"One of {', '.join(effect.siblings)} (probability" in page
    assert ">the answer<" not in page and "equally well" not in page


def test_units_of_parameters_are_those_of_the_device():
    volts = described({**json.loads(DEVICE.document), "responses": {"moment": {"unit": "A m2"}}}, "stack")
    told = [
        volts.own_unit(unit, TIP_DEFLECTION) for unit in ("A/s", "1/m^2", "m", "channel unit/s", "ohm", "K")
    ]
    assert told == ["V/s", "1/(A m2)^2", "A m2", "(A m2)/s", "ohm", "K"]


@pytest.mark.slow
def test_a_zero_that_drifts_is_told(model):
    found = study([recorded(2, change=lambda y: y + 0.1 * np.ptp(y) * np.linspace(0.0, 1.0, y.size))], model)
    (effect,) = assemble_diagnosis(found).effects
    assert found.search.options[0].chosen.keys == (f"sensor_zero_drift:{TIP_DEFLECTION}",)
    assert "sensor_zero_drift" in (effect.id, *effect.siblings) and effect.family == "sensor:stroke"


def test_a_rest_between_the_steps_of_a_converter_is_no_excess(model):
    """Rounding moves what rests by up to half a step, three times its mean power, and for as long as the rest lasts."""
    before = recorded(2)
    volts = before[HEATER_CURRENT].copy()
    volts[500:] = volts[500]
    stroke = LAW(volts)
    step = np.ptp(stroke) / 12
    stroke += (np.floor(stroke[-1] / step) + 0.48) * step - stroke[-1]
    coarse = Recording(
        before.time_s, {HEATER_CURRENT: volts, TIP_DEFLECTION: step * np.round(stroke / step)}, "stack"
    )
    effects = assemble_diagnosis(study([coarse], model)).effects
    assert [effect.id for effect in effects] == ["adc_quantization"]


@pytest.mark.parametrize(
    ("change", "constant", "moved"),
    [
        (lambda y: 1.08 * y, "deflection.gain", 0.08),
        pytest.param(lambda y: y + 4e-6, "deflection.zero", 4e-6, marks=pytest.mark.slow),
    ],
    ids=("8 % more gain", "another zero"),
)
def test_a_gain_or_a_zero_that_has_moved_is_told_as_that(model, change, constant, moved):
    found = study([recorded(2, change=change)], model)
    drift = found.decision.drift
    farthest = int(np.argmax(drift.sigmas))
    assert found.decision.verdict == "drifted" and drift.constants[farthest].name == constant
    assert abs(drift.move[farthest] - moved) < 3.0 * drift.std[farthest] and drift.sigmas[farthest] > 10.0
    (told,) = assemble_diagnosis(found).moved
    assert told.constant == constant and told.std <= drift.std[farthest]
    assert told.now - told.was == pytest.approx(moved, abs=3.0 * told.std)
    corrected = corrected_model(found).parameters
    for name in ("ambient", "linear_gain", "time_constant"):  # free together, these make up for a part of it
        assert corrected[f"model.thermal.{name}"] == pytest.approx(model[f"model.thermal.{name}"], rel=5e-3)
    assert moved_in_place(found) == []
    # if every other constant counted as one that would do as well
    (others,) = moved_in_place(
        study([recorded(2, change=change)], model, limits=replace(found.limits, rival=np.inf))
    )
    assert others.endswith(f" may have moved in place of {constant}") and "thermal." in others
    # the constants moved, the recording is as near to the law as the calibration's held-out parts: no lag makes up for the rest
    assert found.located.own_misfit[TIP_DEFLECTION] < found.limits.own_misfit
    assert found.search.scores and not found.search.singles


@pytest.mark.slow
def test_the_corrected_model_of_fewer_samples_than_its_law_has_parameters_keeps_the_loops():
    plays = fit_model([recorded(1)], DEVICE.key, law="plays")[1]
    found = study([recorded(2, every=16, change=lambda y: 1.3 * y)], plays)
    law = BankShape.of_bank(found.located.nominal.model.deflection)
    assert found.verdict != "agrees" and found.located.problem.count < 2 * law.vector.size
    written = corrected_model(found)
    assert any(name.startswith("model.deflection.") for name in written.parameters)


@pytest.mark.slow
def test_beside_a_constant_that_explains_by_itself_nothing_is_named_within_the_misfit(model):
    late = recorded(2, change=lambda y: 1.12 * (y[0] + lfilter([0.8], [1, -0.2], y - y[0])))
    found = study([late], model)
    assert found.decision.verdict == "drifted" and found.search.options
    assert found.located.own_misfit[TIP_DEFLECTION] < found.limits.unlike_misfit
    (told,) = assemble_diagnosis(found).moved
    assert told.constant == "deflection.gain" and abs(told.now - 1.12) < 3.0 * told.std
    # a set of all that is late otherwise
    assert study([late], model, limits=replace(found.limits, alone=-1.0)).decision.equivalent


@pytest.mark.slow
def test_a_lag_of_the_drive_that_is_many_times_what_it_was_is_a_moved_constant():
    def ramps(seed, lag):
        rng = np.random.default_rng(seed)
        volts = np.interp(np.arange(1600), np.arange(41) * 40, [0.0, 10.0, 0.0, *rng.uniform(0.0, 10.0, 38)])
        late = lfilter([1.0 - np.exp(-0.1 / lag)], [1.0, -np.exp(-0.1 / lag)], volts) if lag else volts
        stroke = LAW(late)
        stroke = stroke + 1e-3 * np.ptp(stroke) * rng.standard_normal(volts.size)
        return Recording(np.arange(1600) * 0.1, {HEATER_CURRENT: volts, TIP_DEFLECTION: stroke}, "stack")

    found = study([ramps(2, 0.5)], fit_model([ramps(1, 0.0)], DEVICE.key)[1])
    (told,) = assemble_diagnosis(found).moved
    assert found.decision.verdict == "drifted" and told.constant == "thermal.time_constant"
    assert told.was < 0.05 and told.now == pytest.approx(0.5, abs=0.1)


def test_what_was_before_is_the_model_as_it_is_also_where_constants_have_moved(model):
    late = recorded(2, change=lambda y: 1.4 * y)
    found = study([late], model)
    predicted = predict(found.located.nominal.model, late).channels[TIP_DEFLECTION]
    assert found.decision.judged.as_fitted[TIP_DEFLECTION] == pytest.approx(
        predicted.error, rel=0.1
    )  # where no fold has been is not judged
    (row,) = found.located.problem.rows
    difference = predicted.measured - predicted.value
    np.testing.assert_allclose(found.located.problem.residual_as_fitted(row), difference, atol=1e-12)


def test_a_moved_ambient_is_told_as_an_offset_of_the_drive_where_nothing_is_heated(unchanged):
    model = unchanged.located.nominal.model
    gain = model.scalars["thermal.linear_gain"]
    room = MovedConstant("thermal.ambient", 30.0, 30.0 + 0.2 * gain, 0.1, "degC")
    assert report._as_drive(unchanged, room) == " (as if the drive were +0.2 V off)"
    assert report._as_drive(unchanged, replace(room, constant="deflection.zero")) == ""


def resistance_of(recording: Recording, gain: float = 1.0, growth: float = 0.0) -> Recording:
    """Of a film whose resistance [ohm] follows the same law over a decade; `growth` of the contact in ohm."""
    decades = recording[TIP_DEFLECTION] / np.ptp(LAW(np.linspace(0.0, 10.0, 50)))
    ohms = gain * 10 ** (3 + decades) + growth * np.linspace(0.0, 1.0, SIZE)
    return Recording(recording.time_s, {HEATER_CURRENT: recording[HEATER_CURRENT], RESISTANCE: ohms}, "film")


@pytest.fixture(scope="module")
def film():
    ohms = described(
        {**json.loads(DEVICE.document), "id": "film", "responses": {"ohms": {"unit": "ohm"}}}, "film"
    )
    return fit_model([resistance_of(recorded(1))], ohms.key, law="plays")[1]


@pytest.mark.slow
def test_a_contact_that_drifts_and_a_zero_of_the_meter_are_told_together(film):
    (effect,) = assemble_diagnosis(study([resistance_of(recorded(2), growth=400.0)], film)).effects
    assert effect.id == "unknown" and effect.family == "sensor:ohms"
    assert {"contact_drift", "sensor_zero_drift"} <= set(effect.siblings)


@pytest.mark.slow
def test_a_gain_of_a_resistance_is_told_as_that_and_not_as_its_logarithm(film):
    found = study([resistance_of(recorded(2), 1.4)], film)
    drift = found.decision.drift
    (place,) = (k for k, c in enumerate(drift.constants) if c.name == "resistance.gain")
    assert found.decision.verdict == "drifted"
    assert abs(drift.move[place] - 0.4) < min(3.0 * drift.std[place], 0.03)


def test_of_a_gain_of_a_resistance_the_logarithm_was_fitted(unchanged):
    problem = unchanged.located.problem
    named = tuple(replace(c, name="resistance.gain") for c in problem.constants)
    plain = drift_of(problem, problem.residual)
    told = drift_of(replace(problem, constants=named), problem.residual)
    assert np.allclose(told.move, np.expm1(plain.move)) and np.allclose(
        told.std, np.exp(plain.move) * plain.std
    )


def test_a_move_is_as_uncertain_as_the_law_misses_more_than_on_its_calibration(unchanged):
    """On another path the law misses otherwise, and constants make up for it: Birge's ratio, on held-out blocks."""
    problem, judged = unchanged.located.problem, unchanged.decision.judged
    plain, floor = drift_of(problem, problem.residual), judged.floor[TIP_DEFLECTION]

    def ratio(after: float, problem=problem) -> float:
        told = decide._drift(
            problem, problem.residual, replace(judged, after={TIP_DEFLECTION: after * floor})
        )
        assert told.chi_square == pytest.approx(plain.chi_square * (plain.std[0] / told.std[0]) ** 2)
        assert np.array_equal(told.move, plain.move)
        return float(told.std[0] / plain.std[0])

    assert ratio(0.7) == 1.0 and ratio(3.0) == pytest.approx(3.0)
    # where the noise is a sensor's, what is left beyond it is told by itself
    body = replace(problem.nominal.model, device=preset("integrated").key)
    assert ratio(3.0, replace(problem, nominal=replace(problem.nominal, model=body))) == 1.0


def test_constants_that_move_for_less_than_the_law_misses_have_not_drifted(unchanged):
    problem, judged = unchanged.located.problem, unchanged.decision.judged
    floor = judged.floor[TIP_DEFLECTION]

    def shows(before: float, device=DEVICE, after: float = 1.0) -> bool:
        model = replace(problem.nominal.model, device=device.key)
        of = replace(problem, nominal=replace(problem.nominal, model=model))
        told = replace(judged, before={TIP_DEFLECTION: before * floor}, after={TIP_DEFLECTION: after * floor})
        return decide._shows(of, told, unchanged.limits)

    assert not shows(1.4) and shows(1.5)
    assert shows(1.0, preset("integrated"))
    # and for most of what is missed: half of 8 is the calibration's error and 3 more
    assert shows(3.0, after=2.2) and not shows(3.0, after=2.3) and shows(3.0, preset("integrated"), after=2.9)


def test_a_correction_of_the_loop_knows_nothing_of_the_rest_without_drive(model):
    """Without drive this device is at its middle: a recording that begins elsewhere does not remember that."""
    nominal = Nominal.from_parameters(model)
    shapes = loop_shapes(nominal)
    volts = 5.0 + 4.0 * np.sin(np.linspace(-1.0, 12.0, 300))
    corrected = replace(nominal, corrections={c: shape.fold() for c, shape in shapes.items()})
    plain, with_it = (one.respond(volts, 0.1, settled=True) for one in (nominal, corrected))
    added = with_it.channels[TIP_DEFLECTION] - plain.channels[TIP_DEFLECTION]
    expected = shapes[TIP_DEFLECTION].fold()(plain.temperature)
    assert np.max(np.abs(added - expected)) < 1e-12 and np.ptp(added) > 1e-9


@pytest.mark.parametrize(
    "changes",
    [
        {"cantilever_resonance": {"share": 0.4, "frequency": 0.8, "damping": 0.02}},
        {"log_creep": {"rate": 0.02, "onset": 0.3}},
        {"sensor_lag:tip_deflection": {"signal": TIP_DEFLECTION, "time_constant": 0.4}},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_what_is_behind_the_film_begins_at_rest_with_the_first_drive(model, changes):
    """A ring from a start elsewhere would last: 1 / (2 pi f zeta) is 10 s here, a hundred samples."""
    nominal, held = Nominal.from_parameters(model), np.full(300, 7.0)
    plain, changed = (
        nominal.respond(held, 0.1, effects=effects, settled=True).channels[TIP_DEFLECTION]
        for effects in ({}, changes)
    )
    assert np.abs(changed - plain).max() < 1e-4 * np.ptp(recorded(2)[TIP_DEFLECTION])  # ten lags of the drive


def test_a_response_goes_straight_from_sample_to_sample_where_no_body_is_heated(model):
    """The lag of a straight line is the line a time constant ago, and a mode rings as scipy's, held to first order."""
    nominal, dt, tau = Nominal.from_parameters(model), 0.1, 0.25
    volts = recorded(2)[HEATER_CURRENT]
    lag = {"sensor_lag:tip_deflection": {"signal": TIP_DEFLECTION, "time_constant": tau}}
    mode = {"cantilever_resonance": {"share": 0.6, "frequency": 0.8, "damping": 0.05}}
    plain, slow, ringing = (
        nominal.respond(volts, dt, effects=effects, settled=True).channels[TIP_DEFLECTION]
        for effects in ({}, lag, mode)
    )
    w, time = 2 * np.pi * 0.8, np.arange(plain.size) * dt
    for given, expected in (
        (([1.0], [tau, 1.0]), slow),
        (([w**2], [1.0, 2 * 0.05 * w, w**2]), plain + (ringing - plain) / 0.6),
    ):
        exact = plain[0] + lsim(given, plain - plain[0], time)[1]
        assert np.abs(expected - exact).max() < 1e-3 * np.ptp(plain)


def test_a_steep_ripple_is_found_where_it_folds_the_measured_values(model):
    """Its slope of 1.6 shows three values at once: crests are counted along the simulated ones."""
    span = np.ptp(recorded(2)[TIP_DEFLECTION])
    pitch = span / 6.3
    found = study([recorded(2, change=lambda y: y + 0.04 * span * np.sin(2 * np.pi * y / pitch))], model)
    (effect,) = assemble_diagnosis(found).effects
    assert effect.id == "sensor_ripple"
    assert found.decision.chosen.values[0]["pitch"] == pytest.approx(pitch, rel=0.05)
    # a small misfit looks larger where the ripple is steep: that is no sign of something else
    assert 1.2 < shown(found.decision.final, TIP_DEFLECTION) < 2.0


def test_a_response_that_is_missing_is_named_as_the_device_names_it_and_units_are_its_own(unchanged):
    found = unchanged
    both = described(
        {**json.loads(DEVICE.document), "responses": {"stroke": {"unit": "m"}, "ohms": {"unit": "ohm"}}}, "x"
    )
    nominal = found.located.problem.nominal
    other = replace(nominal.model, device=both.key)
    problem = replace(found.located.problem, nominal=replace(nominal, model=other))
    asked = replace(found, located=replace(found.located, problem=problem))
    told = report.in_own_names(report._of_what(asked), asked)
    assert told == " in stroke (ohms could not be judged)"
    assert report._of_what(found) == ""
    assert [report._unit(unit, found) for unit in ("K/A^2", "K/A", "degC", "1", "s")] == [
        "K/V^2", "K/V", "degC", "1", "s",
    ]  # fmt: skip


def test_every_channel_has_the_name_of_the_devices_own_file(lagging):
    """The answer and the page speak of the recording's channels; of a response that the device has not, nothing is said."""
    answer = assemble_diagnosis(lagging)
    assert answer.effects[0].family.endswith(":stroke") and set(answer.fit) == {"stroke"}
    assert set(answer.excess) == {"stroke", "total"} and {one.signal for one in answer.location} == {"stroke"}
    text = json.dumps(answer.to_dict()) + report_page(lagging, answer)
    assert not any(role in text for role in (TIP_DEFLECTION, RESISTANCE, HEATER_CURRENT))


def test_a_late_clock_is_found_where_constants_have_moved_besides(unchanged, monkeypatch):
    """Measured values that stand by another zero are nearest to the simulation at no delay, or at a wrong one."""
    problem = unchanged.located.problem
    assert _lateness(problem, (TIP_DEFLECTION,)) == []
    late = problem.stack(_late(problem, [TIP_DEFLECTION], 12))
    zero = problem.nuisance.thermal[:, problem.column_of("deflection.zero")]
    far = 5.0 * np.linalg.norm(late) / np.linalg.norm(zero) * zero
    moved = replace(problem, residual=problem.residual + late + far)
    assert _lateness(moved, (TIP_DEFLECTION,)) == pytest.approx([1.2])
    monkeypatch.setattr(hypotheses, "LONG", problem.weight.size - 1)
    assert _lateness(moved, (TIP_DEFLECTION,)) == []


def test_a_late_response_is_found_where_its_gain_has_moved_to_the_other_sign(unchanged, monkeypatch):
    """A delay of half a swing looks like a gain below nothing: delays are looked for beside the model as calibrated, too."""
    problem = unchanged.located.problem
    monkeypatch.setattr(hypotheses, "LONG", problem.weight.size - 1)
    parts = tuple(
        replace(part, observed={TIP_DEFLECTION: np.roll(part.observed[TIP_DEFLECTION], 12)})
        for part in problem.parts
    )
    turned = tuple(
        replace(response, channels={c: -values for c, values in response.channels.items()})
        for response in problem.nominal_responses
    )
    gain = np.zeros_like(problem.origin)
    gain[problem.column_of("deflection.gain")] = (
        -2.0 / problem.constants[problem.column_of("deflection.gain")].spread
    )
    late = replace(problem, parts=parts, nominal_responses=turned, origin=gain)
    assert min(abs(delay - 1.2) for delay in _lateness(late, (TIP_DEFLECTION,))) < 0.15


@pytest.mark.parametrize(("at_bound", "taken"), [((), 1), (("averaging.window",), 0)])
def test_what_goes_to_its_bound_does_not_take_the_place_of_what_can_be_named(
    lagging, monkeypatch, at_bound, taken
):
    found = lagging
    singles = [one for one in found.search.singles if not one.at_bound][:2]

    def fitted(nominal, problem, best, rivals, limits, tick):
        place = singles.index(best)
        ends, gain = ((), 0.5 * best.gain) if place == 0 else (at_bound, best.gain)
        chosen = replace(best, gain=gain, at_bound=ends, chi_square=problem.residual_chi_square - gain)
        return SimpleNamespace(chosen=chosen)

    monkeypatch.setattr(third_stage, "option_of", fitted)
    monkeypatch.setattr(third_stage, "_in_one_switch", lambda located, alone, *others: alone)
    monkeypatch.setattr(third_stage, "_where_told", lambda located, alone, *others: alone)
    (option,) = third_stage._options(found.located, singles, [], found.limits, Clock(lambda *told: None, 1))
    assert option.chosen.keys == singles[taken].keys


def test_a_recording_that_says_it_is_of_another_device_is_told_and_two_are_refused(model):
    other = replace(recorded(2), device="press")
    told = assemble_diagnosis(study([other], model)).summary
    assert told.startswith(
        "recording 1: says that it is of device press, the model is of stack. Simulation and recording agree"
    )
    with pytest.raises(
        ValueError, match="recordings of the devices stack and press, need those of one device"
    ):
        study([recorded(2), other], model)
    with pytest.raises(
        ValueError, match="recordings of the devices stack and press, need those of one device"
    ):
        fit_model([recorded(1), replace(recorded(2), device="press")], DEVICE.key)


def test_what_is_refused_is_told_in_the_names_and_units_of_the_device(model):
    still = recorded(2)
    still = replace(still, channels={**still.channels, HEATER_CURRENT: 5.0 + 1e-3 * still[HEATER_CURRENT]})
    with pytest.raises(
        ValueError, match=r"volts varies by 0\.01 V of an operating range of 10: check its unit"
    ):
        study([still], model)


@pytest.mark.slow
def test_a_constant_does_not_follow_an_effect_by_more_than_the_calibration_allows(model):
    """A response that comes five samples late is no dead time that the calibration has told wrongly by forty deviations."""
    found = study([recorded(2, change=lambda y: np.concatenate([np.full(5, y[0]), y[:-5]]))], model)
    problem = found.located.problem
    own = [
        abs(z) for z, constant in zip(problem.origin, problem.constants, strict=True) if not constant.drifts
    ]
    assert max(own, default=0.0) <= found.limits.mistaken
    told = {effect.id for effect in assemble_diagnosis(found).effects} | {
        sibling for effect in assemble_diagnosis(found).effects for sibling in effect.siblings
    }
    assert {"dead_time", "clock_offset"} <= told
