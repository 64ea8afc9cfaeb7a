"""Every hysteresis law behind the one protocol: stream, batch, peek, memory, inverse, model file, compiled use."""

import sys

import numpy as np
import pytest
from numba import njit
from vo2_models.hysteresis import CPI, EGPI, GPI, Polynomial, TanhEnvelopes, laws
from vo2_models.hysteresis.bouc_wen import BoucWen
from vo2_models.hysteresis.domains import DomainEnsemble
from vo2_models.hysteresis.law import LawInverse
from vo2_models.hysteresis.laws import ADDED, LAWS, bank_parameters, law_from_parameters, law_parameters
from vo2_models.hysteresis.limiting_loop import LimitingLoop
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.hysteresis.preisach import NonMonotonicPreisach, PreisachOperator
from vo2_models.model_file import load_model_parameters, save_model_parameters

RNG = np.random.default_rng(7)
INPUTS = np.concatenate(
    [[30.0, 90.0, 30.0], RNG.uniform(40.0, 85.0, 200), [70.0, 70.0], RNG.uniform(0, 120, 50)]
)


def _laws():
    tanh = TanhEnvelopes(0.2, -13.0, 0.2, -11.5)
    walls = np.linspace(45.0, 80.0, 11)
    operator = PreisachOperator(walls, RNG.uniform(0.0, 2.0, 55), 0.5)
    alpha = RNG.normal(68.0, 3.0, 40)
    return {
        "plays": PlayBank(
            [0.5, 1.0], [0.0, 0.3], [0.2, 0.3], [-13.0, -19.0], [0.2, 0.3], [-11.0, -17.0], [1.0, 0.01]
        ),
        "cpi": CPI([0.0, 5.0], [1.0, 2.0], 0.3),
        "gpi": GPI([0.0, 0.4], [1.0, 2.0], tanh, 0.3),
        "egpi": EGPI([0.0, 0.4], [1.0, 2.0], tanh, Polynomial([0.2, 0.01]), 0.3),
        "preisach": operator,
        "nonmonotonic": NonMonotonicPreisach(operator, 0.002, 0.004, 22.0),
        "bouc_wen": BoucWen(0.3, 0.8, 1.5, 2.0, [0.1, 0.02]),
        "limiting_loop": LimitingLoop(0.3, 68.0, 0.25, 60.0, 0.9, -1.0, 2.0, [0.0, 0.01]),
        "domains": DomainEnsemble(
            alpha, alpha - RNG.uniform(2.0, 9.0, 40), RNG.uniform(0.5, 1.5, 40), 1.5, -2.0, 3.0, [0.1, 0.01]
        ),
    }


EXAMPLES = {**_laws(), **ADDED}
NAMES = pytest.mark.parametrize("name", sorted(EXAMPLES))


def test_there_is_an_example_of_every_law():
    assert set(EXAMPLES) == set(LAWS)
    for name, law in EXAMPLES.items():
        assert type(law) is LAWS[name] and law.name == name


@NAMES
def test_stream_batch_and_peek_agree_and_a_peek_changes_nothing(name):
    law = EXAMPLES[name]
    memory = law.initial_memory()
    assert memory.dtype == np.float64 and memory.shape == (law.memory_size,)
    streamed = []
    for u in INPUTS:
        before = memory.copy()
        tried = law.peek(u, memory)
        assert np.array_equal(memory, before)
        streamed.append(law.step(u, memory))
        assert streamed[-1] == tried
    assert law.run(INPUTS) == pytest.approx(streamed, rel=1e-12, abs=1e-12)
    split = law.initial_memory()
    halves = np.concatenate([law.run(INPUTS[:100], split), law.run(INPUTS[100:], split)])
    assert np.array_equal(halves, law.run(INPUTS))


@NAMES
def test_a_misspelt_saturation_is_no_other_end(name):
    with pytest.raises(ValueError, match=r"saturation: found 'Lower', need 'lower' or 'upper'"):
        EXAMPLES[name].initial_memory("Lower")


def test_a_law_that_asks_for_one_end_only_refuses_a_misspelt_other_too():
    class Careless(BoucWen):
        def initial_memory(self, saturation="lower"):
            return super().initial_memory("lower" if saturation == "lower" else "upper")

    law = Careless(0.3, 0.8, 1.5, 2.0)
    assert np.array_equal(law.initial_memory("upper"), BoucWen(0.3, 0.8, 1.5, 2.0).initial_memory("upper"))
    with pytest.raises(ValueError, match=r"saturation: found 'Lower', need 'lower' or 'upper'"):
        law.settle(50.0, "Lower")


@NAMES
def test_a_memory_that_a_step_cannot_change_is_refused(name):
    law = EXAMPLES[name]
    memory = law.settle(50.0)
    fixed = memory.copy()
    fixed.setflags(write=False)
    for wrong, said in (
        (np.zeros(law.memory_size, dtype=int), "found int64 array, need an array of float64"),
        (memory.astype(np.float32), "found float32 array"),
        (memory.astype(">f8"), "found >f8 array|found >?f.*array|found float64 array"),
        (memory.tolist(), "found list, need an array of float64"),
        (fixed, "found a read-only array, need one that a step may change"),
        (np.full(law.memory_size, np.nan), "found a NaN, need numbers"),
    ):
        for call in (lambda m: law.step(60.0, m), lambda m: law.run([60.0], m)):
            with pytest.raises(ValueError, match=f"memory: ({said})"):
                call(wrong)


@NAMES
def test_rate_independence(name):
    """Samples put in between the turning points change nothing."""
    law = EXAMPLES[name]
    fine = np.interp(np.arange(0, INPUTS.size - 1, 0.25), np.arange(INPUTS.size), INPUTS)
    # all but Bouc-Wen are solved in closed form
    tolerance = 2e-6 if name == "bouc_wen" else 1e-9
    assert law.run(fine)[::4] == pytest.approx(law.run(INPUTS)[:-1], rel=1e-9, abs=tolerance)


@NAMES
def test_settled_memory_is_the_one_of_a_long_excursion(name):
    law = EXAMPLES[name]
    for saturation, far in (("lower", -1e4), ("upper", 1e4)):
        path = law.initial_memory()
        law.run([1e4, far, 66.0], path)
        assert law.peek(80.0, law.settle(66.0, saturation)) == pytest.approx(law.peek(80.0, path), abs=1e-9)
    if name != "cpi":
        low, high = (law.run([-far, far])[1] - law.polynomial_part(far) for far in (-1e4, 1e4))
        if name == "nonmonotonic":
            low, high = (law.run([end])[0] for end in law.operator.walls[[0, -1]])
        if name == "egpi":
            low, high = low - 0.01 * -1e4 - 0.2, high - 0.01 * 1e4 - 0.2
        assert (low, high) == pytest.approx(law.span)


@NAMES
def test_the_inverse_gives_the_input_of_an_output(name):
    law = EXAMPLES[name]
    inverse = law.inverse((40.0, 90.0))
    memory = law.settle(40.0)
    model = memory.copy()
    for wanted in law.run(np.r_[40.0, np.random.default_rng(7).uniform(55.0, 80.0, 20)])[1:]:
        found = inverse.invert(wanted, memory)
        step = law.step(found.input, model)
        tolerance = 0.05 * np.ptp(law.span) if name == "domains" else 1e-6
        assert abs(step - wanted) <= tolerance
        assert found.output == pytest.approx(step)
        assert found.reached or name == "domains"


@NAMES
@pytest.mark.parametrize("limits", [(62.0, 72.0), (40.0, 66.0), (66.0, 95.0)])
def test_the_inverse_stays_in_its_input_range_and_flags_where_it_had_to_clip(name, limits):
    law = EXAMPLES[name]
    inverse = law.inverse(limits)
    memory = law.settle(limits[0])
    rng = np.random.default_rng(3)
    within = law.run(rng.uniform(*limits, 20), memory.copy())
    width = np.ptp(within)
    for wanted in np.concatenate(
        [within, rng.permutation(np.r_[within, within + 2 * width, within - 2 * width])]
    ):
        ends = [law.peek(end, memory) for end in limits]
        found = inverse.invert(wanted, memory)
        assert limits[0] <= found.input <= limits[1]
        assert found.output == pytest.approx(law.peek(found.input, memory), rel=1e-12)
        if found.reached:
            assert found.output == pytest.approx(wanted, abs=1e-6 * width)
        elif wanted < min(ends) or wanted > max(ends):
            assert found.input in limits
        else:
            assert name == "domains"  # jumps between the outputs that a finite number of domains can give
        if wanted < min(ends) - width or wanted > max(ends) + width:
            assert not found.reached


def test_the_inverse_by_bisection_flags_what_it_cannot_reach():
    law = EXAMPLES["gpi"]
    inverse = LawInverse(law, (40.0, 90.0))
    memory = law.settle(40.0)
    assert inverse.invert(1.0, memory) == pytest.approx(
        law.inverse((40.0, 90.0)).invert(1.0, law.settle(40.0))
    )
    out_of_reach = inverse.invert(99.0, memory)
    assert not out_of_reach.reached and out_of_reach.input == 90.0


@NAMES
def test_a_law_survives_its_model_file(name, tmp_path):
    law = EXAMPLES[name]
    if name == "cpi":
        with pytest.raises(ValueError, match=r"model: found LinearEnvelopes and Zero, need tanh"):
            law.to_parameters("model.resistance")
        return
    save_model_parameters(tmp_path / "model.yaml", law.to_parameters("model.resistance"))
    again = law_from_parameters("model.resistance", load_model_parameters(tmp_path / "model.yaml"))
    assert again.run(INPUTS) == pytest.approx(law.run(INPUTS), rel=1e-12, abs=1e-12)
    declared = {p.name for p in law_parameters("model.resistance", "the resistance", "log10 ohm")}
    assert set(law.to_parameters("model.resistance")) <= declared


def test_parameters_are_named_where_they_are_missing_or_wrong():
    with pytest.raises(ValueError, match=r"model.x.law: found 'magic', need one of plays, preisach"):
        law_from_parameters("model.x", {"model.x.law": "magic"})
    with pytest.raises(ValueError, match=r"model.x.density: found none, need it for the law 'preisach'"):
        law_from_parameters("model.x", {"model.x.law": "preisach", "model.x.walls": [0.0, 1.0]})
    with pytest.raises(ValueError, match=r"model.x.walls: found 0 after 1 at index 1"):
        law_from_parameters(
            "model.x", {"model.x.law": "preisach", "model.x.walls": [1.0, 0.0], "model.x.density": [1.0]}
        )
    with pytest.raises(ValueError, match=r"model.x.radii: found 1 value\(s\), need 2"):
        law_from_parameters("model.x", {"model.x.weights": [1.0, 2.0], "model.x.radii": [0.0]})
    assert {p.name for p in bank_parameters("x", "y", "m")} == {f"x.{n}" for n in PlayBank.described}


@NAMES
def test_bad_inputs_and_memories_are_refused(name):
    law = EXAMPLES[name]
    memory = law.settle(50.0)
    with pytest.raises(ValueError, match=r"u: found nan"):
        law.step(np.nan, memory)
    with pytest.raises(ValueError, match=r"memory: found shape \(1,\), need"):
        law.step(1.0, np.zeros(1))
    with pytest.raises(ValueError, match=r"memory: found shape \(1,\), need"):
        law.run([1.0], np.zeros(1))


@NAMES
def test_any_law_goes_into_another_compiled_loop(name):
    law = EXAMPLES[name]
    move = type(law).move

    @njit
    def device(current, packed, memory):
        """A tiny device: a lag before the law."""
        temperature, out = 22.0, np.empty(current.size)
        for k in range(current.size):
            temperature += 0.5 * (22.0 + 1e6 * current[k] ** 2 - temperature)
            out[k] = move(temperature, packed, memory, True)
        return out

    current = np.random.default_rng(7).uniform(3e-3, 8e-3, 50)
    temperature, path = 22.0, []
    for i in current:
        temperature += 0.5 * (22.0 + 1e6 * i**2 - temperature)
        path.append(temperature)
    expected = law.run(path) - law.polynomial_part(np.array(path))
    assert device(current, law.packed, law.initial_memory()) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_the_bank_of_a_fitted_model_is_the_model():
    for name in ("gpi", "egpi"):
        assert EXAMPLES[name].bank().run(INPUTS) == pytest.approx(EXAMPLES[name].run(INPUTS), abs=1e-12)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of laws."""
    monkeypatch.setattr(laws, "__path__", [str(tmp_path)])
    yield tmp_path
    for file in tmp_path.glob("*.py"):
        sys.modules.pop(f"{laws.__name__}.{file.stem}", None)


OWN = """
from vo2_models.hysteresis.bouc_wen import BoucWen

class Own(BoucWen):
    name = "own"

EXAMPLE = Own(0.3, 0.8, 1.5, 2.0, [0.1, 0.02])
"""


def test_a_file_in_the_folder_is_a_law(folder):
    (folder / "own.py").write_text(OWN)
    assert type(laws._added()["own"]).__name__ == "Own"


@pytest.mark.parametrize(
    ("text", "said"),
    [("X = 1\n", "other.py: found EXAMPLE = None, need one law"), (OWN, "found the name own twice")],
)
def test_a_file_that_is_no_law_is_refused(folder, text, said):
    (folder / "a_own.py").write_text(OWN)
    (folder / "other.py").write_text(text)
    with pytest.raises(ValueError, match=said):
        laws._added()
