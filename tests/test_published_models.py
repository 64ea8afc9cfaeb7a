"""The printed parameters as files: what they say is what is printed, and every node that they are for takes them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from vo2_identification.compress import main as compress
from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis import EGPI, Cosine
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.model_file import load_model_parameters
from vo2_models.parameters import Value
from vo2_models.self_sensing import self_sensing
from vo2_studies.published_models import OPERATING, SURROGATE, main, printed_deflection, printed_resistance

FOLDER = Path(__file__).parents[1] / "src" / "vo2_studies" / "config"
MODELS = {"tables_7_1_and_7_2": ("plant", "estimator", "controller"), "table_6_3": ("plant", "estimator")}
CONTROLLERS = ("pi_chapter_7", "pid_chapter_8", "hinf_chapter_8", "robust_8_10")


def _run(law, inputs):
    memory = law.initial_memory()
    return np.array([law.step(float(u), memory) for u in inputs])


def test_the_tables_of_chapter_7_are_what_is_printed():
    model = DeviceModel.load(FOLDER / "tables_7_1_and_7_2.yaml")
    share = damped_oscillation(np.linspace(0.0, 1.0, 20))
    current = OPERATING[0] + (OPERATING[1] - OPERATING[0]) * share
    np.testing.assert_allclose(
        _run(model.deflection, SURROGATE * current), 1e-6 * _run(printed_deflection(), current), rtol=1e-9
    )
    # a table of ohm as a law of -log10 R: fitted, to 0.02 decades on excursions that it was not fitted on
    wanted = -np.log10(-_run(printed_resistance(), current))
    assert np.sqrt(np.mean((_run(model.resistance, SURROGATE * current) - wanted) ** 2)) < 0.02
    assert model.simulation.simulate(np.repeat(current, 3), noise=False)["tip_deflection"].min() > 40e-6


def test_table_6_3_is_the_printed_operator():
    law = DeviceModel.load(FOLDER / "table_6_3.yaml").deflection
    printed = EGPI([0, 0.2, 0.4, 0.6, 0.8, 2], [6, 2, 1, 2, 4, 4], memoryless=Cosine(5.0))
    v = np.random.default_rng(1).uniform(-10, 10, 200)
    start = printed.initial_state(v=0.0, memory=[0.0] * 6)
    wanted = np.asarray(printed.simulate(v, start)[0])
    memory = np.zeros(7)
    found = np.array([law.step(float(u), memory) for u in v])
    np.testing.assert_allclose(found, wanted, atol=0.02)  # of 190: the envelopes are tanh of a thousandth


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"model.self_sensing.bounds.log10_resistance": [4.0, 3.0, 5.0], "model.self_sensing.bounds.composite": [1e-6] * 3},
         "model.self_sensing.bounds.log10_resistance: found 3 after 4 at index 1, need strictly increasing values"),
        ({"model.self_sensing.preisach.walls": [0.0, 2.0, 1.0], "model.self_sensing.preisach.domain": [4.0, 5.0],
          "model.self_sensing.preisach.weights": [1e-6] * 3, "model.self_sensing.preisach.coefficients": [0.0]}, "walls"),
        ({"model.resistance.radii": [0.0]}, "model.resistance.radii: found 1 value"),
    ],
)  # fmt: skip
def test_tables_of_a_model_file_that_do_not_rise_or_do_not_fit_are_one_line(changes, said):
    parameters = load_model_parameters(FOLDER / "tables_7_1_and_7_2.yaml") | changes
    kind = "preisach" if "model.self_sensing.preisach.walls" in changes else "composite"
    with pytest.raises(ValueError, match=said) as refused:
        self_sensing(kind, parameters)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("radii", lambda r: r[::-1], "model.resistance.radii: found .* after .* at index 1, need ascending radii"),
        ("radii", lambda r: [-0.1, *r[1:]], "model.resistance.radii: found -0.1 at index 0, need values >= 0"),
        ("rising_slopes", lambda s: [-s[0], *s[1:]], "model.resistance.rising_slopes: found -.* at index 0, need slopes above 0"),
        ("falling_slopes", lambda s: [*s[:-1], 0.0], "model.resistance.falling_slopes: found 0 at index 11, need slopes above 0"),
    ],
)  # fmt: skip
def test_plays_that_are_not_monotonic_are_one_line_wherever_a_model_is_read(name, change, said):
    parameters: dict[str, Any] = dict(load_model_parameters(FOLDER / "tables_7_1_and_7_2.yaml"))
    parameters[f"model.resistance.{name}"] = change(list(parameters[f"model.resistance.{name}"]))
    for read in (DeviceModel.from_parameters, lambda p: self_sensing("composite", p)):
        with pytest.raises(ValueError, match=said) as refused:
            read(parameters)
        assert "\n" not in str(refused.value)


def test_a_grid_that_does_not_rise_is_one_line_when_a_model_is_read():
    parameters = load_model_parameters(FOLDER / "tables_7_1_and_7_2.yaml")
    grid: dict[str, Any] = {"law": "preisach", "walls": [0.0, 2.0, 1.0], "density": [1.0] * 3, "bias": 0.0}
    kept = {k: v for k, v in parameters.items() if not k.startswith("model.resistance.")}
    with pytest.raises(ValueError, match=r"model.resistance.walls: found 1 after 2 at index 2"):
        DeviceModel.from_parameters(kept | {f"model.resistance.{k}": v for k, v in grid.items()})


@pytest.mark.slow
def test_the_files_are_what_the_command_writes(tmp_path):
    assert main(["--output", str(tmp_path)]) == 0
    for name in (*MODELS, *CONTROLLERS):
        written, shipped = (folder / f"{name}.yaml" for folder in (tmp_path, FOLDER))
        head = [
            [line for line in path.read_text().splitlines() if line.startswith("#")]
            for path in (written, shipped)
        ]
        assert head[0] == head[1], name
        # a law that was fitted comes out the same on every machine but for rounding
        found, expected = (
            yaml.safe_load(path.read_text())["/**"]["ros__parameters"] for path in (written, shipped)
        )
        assert found.keys() == expected.keys(), name
        for key, value in expected.items():
            if isinstance(value, float | list):
                assert found[key] == pytest.approx(value, rel=1e-6, abs=1e-9), key
            else:
                assert found[key] == value, key


def test_every_node_takes_its_published_file(graph, conductor):
    names = []
    for file, nodes in (*MODELS.items(), *((name, ("controller",)) for name in CONTROLLERS)):
        for node in nodes:
            name = f"{node}_{file}"
            # simulated time stands: nothing is asked of a loop that runs as fast as it can
            stands: dict[str, Value] = {"run_until_s": 1.0} if node == "plant" else {}
            graph.start(node, name=name, parameters=stands, parameter_file=FOLDER / f"{file}.yaml")
            names.append(f"/vo2/{name}")
    conductor.wait_for_nodes(names)
    graph.check()


def test_a_folder_that_is_a_file_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["--output", str(tmp_path / "file")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_the_printed_tables_can_be_compressed(tmp_path):
    """Table 7.2's envelopes cross by 0.02: a law that the plant runs is a law that `compress` takes."""
    small = tmp_path / "small.yaml"
    assert (
        compress(["--model", str(FOLDER / "tables_7_1_and_7_2.yaml"), "--plays", "3", "--output", str(small)])
        == 0
    )
    model = DeviceModel.load(small)
    for law in (model.deflection, model.resistance):
        assert isinstance(law, PlayBank) and 1 <= np.size(law.weights) <= 3
    assert self_sensing("composite", load_model_parameters(small)).initial_state() is not None
