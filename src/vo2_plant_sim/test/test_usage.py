"""`--help` of the nodes names every parameter that the node declares."""

import sys
from types import ModuleType

import pytest
from vo2_interface.executable import run_nodes
from vo2_interface.usage import usage
from vo2_models.parameters import Parameter

from vo2_plant_sim import plant_node

LONG = "How often it does that, told at such length that it cannot stand in a single line: one long-winded line after the other."


def test_every_parameter_with_default_unit_range_and_meaning():
    module = ModuleType("node", "`node`: does.\n\nMore.")
    module.SOME_PARAMETERS = (
        Parameter("rate", 2.0, "Hz", LONG, 0.5, 10.0),
        Parameter("kind", "a", "", "Which one.", choices=("a", "b")),
        Parameter("model.gain", 1.0, "1", "Comes from a file."),
    )
    said = usage(module)
    assert said.startswith("`node`: does.\n\nMore.\n\nParameters:\n")
    assert "  rate (float, default 2.0 Hz; 0.5 to 10)\n      How often it does that" in said
    assert "one long-winded line\n      after the other" in said
    assert "  kind (string, default 'a'; one of a, b)\n      Which one." in said
    assert "model.gain" not in said and "--params-file FILE" in said


def test_the_plant_tells_on_standard_output_what_it_declares(capsys):
    assert run_nodes(plant_node.PlantNode, args=["plant", "--help"]) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    for record in (*plant_node.PLANT_PARAMETERS, *plant_node.SIMULATED_DEVICE_PARAMETERS):
        if not record.name.startswith("model."):
            assert f"  {record.name} ({record.type}, default " in printed.out
    assert max(map(len, printed.out.splitlines())) < 200


@pytest.mark.parametrize("option", ["--speed", "fast"])
def test_what_is_no_ros_argument_is_one_line(capsys, option):
    assert run_nodes(plant_node.PlantNode, args=[sys.argv[0], option]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"found {option}; nodes take ROS arguments only" in line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "found no such file"),
        ("not: yaml: [", "cannot be read as a ROS parameter file ("),
    ],
)
def test_a_parameter_file_that_cannot_be_used_is_one_line(capsys, tmp_path, text, said):
    path = tmp_path / "model.yaml"
    if text is not None:
        path.write_text(text)
    assert run_nodes(plant_node.PlantNode, args=["plant", "--ros-args", "--params-file", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"--params-file {path}: {said}" in line and line.endswith("`fit` or `identifier` wrote")
    assert "/project/" not in line
