"""Launch files: what they start exists, their parameters are declared; built where ROS 2's launch is installed.

`launch` is not among the wheels of PyPI (what is called so there is another package), so that machines without
ROS 2 check what the files name, and machines with it build their descriptions.
"""

import ast
import importlib.util
import re
from pathlib import Path

import pytest
import yaml
from vo2_control.controller_node import CONTROLLER_NODE_PARAMETERS, ControllerNode
from vo2_control.designs import CONTROLLER_PARAMETERS
from vo2_control.reference_node import REFERENCE_PARAMETERS
from vo2_estimation.estimator_node import ESTIMATOR_PARAMETERS
from vo2_identification.identifier_node import IDENTIFIER_PARAMETERS
from vo2_interface.live.node import LIVE_PARAMETERS
from vo2_interface.testing import bench
from vo2_plant_sim.plant_node import PLANT_PARAMETERS, PlantNode
from vo2_plant_sim.simulated_device import SIMULATED_DEVICE_PARAMETERS

SOURCES = Path(__file__).resolve().parents[1] / "src"
FOREIGN = {"robot_state_publisher": {"robot_state_publisher"}}
"""Package of ROS 2 -> its executables."""
LAUNCH_FILES = sorted(SOURCES.glob("*/launch/*.launch.py"))
DECLARED = {
    "plant": (*PLANT_PARAMETERS, *SIMULATED_DEVICE_PARAMETERS),
    "estimator": ESTIMATOR_PARAMETERS,
    "controller": (*CONTROLLER_NODE_PARAMETERS, *CONTROLLER_PARAMETERS),
    "reference": REFERENCE_PARAMETERS,
    "identifier": IDENTIFIER_PARAMETERS,
    "live": LIVE_PARAMETERS,
}


def texts(path):
    """All strings in a Python file."""
    tree = ast.parse(path.read_text())
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]


def executables(package):
    """Names that a package installs as executables."""
    if package in FOREIGN:
        return FOREIGN[package]
    return set(re.findall(r'"(\w+) = [\w.]+:\w+"', (SOURCES / package / "setup.py").read_text()))


def started(path):
    """(package, executable) of every node that a launch file starts: neighbours in a tuple or keywords of a call."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Tuple):
            values = [each.value for each in node.elts if isinstance(each, ast.Constant)]
            if len(values) == len(node.elts) == 2:
                found.add(tuple(values))
        elif isinstance(node, ast.Call):
            given = {
                each.arg: each.value.value for each in node.keywords if isinstance(each.value, ast.Constant)
            }
            if {"package", "executable"} <= set(given):
                found.add((given["package"], given["executable"]))
    return found


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_what_a_launch_file_starts_is_installed(path):
    nodes = started(path)
    assert nodes
    for package, executable in nodes:
        assert executable in executables(package), (package, executable)


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_what_a_launch_file_needs_is_a_dependency_and_is_installed_with_it(path):
    package = path.parents[1]
    manifest, setup = (package / "package.xml").read_text(), (package / "setup.py").read_text()
    needed = {other for other, _ in started(path)} - {package.name}
    for name in {"launch", "launch_ros", *needed}:
        assert f"<exec_depend>{name}</exec_depend>" in manifest, name
    assert 'glob("launch/*.launch.py")' in setup
    for name in [
        text for text in texts(path) if text.endswith(".yaml") and (package / "config" / text).exists()
    ]:
        assert 'glob("config/*.yaml")' in setup, name


# the live page runs beside a loop and takes its time from it
LOOPS = [path for path in LAUNCH_FILES if '"plant"' in path.read_text()]


@pytest.mark.parametrize("path", LOOPS, ids=lambda path: path.name)
def test_one_argument_chooses_wall_time_or_lockstep(path):
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    named = [call for call in calls if getattr(call.func, "id", "") == "DeclareLaunchArgument"]
    arguments = {
        ast.literal_eval(call.args[0]): {word.arg: word.value for word in call.keywords} for call in named
    }
    (choices,) = (record.choices for record in PLANT_PARAMETERS if record.name == "time")
    assert tuple(ast.literal_eval(arguments["time"]["choices"])) == choices
    assert ast.literal_eval(arguments["use_sim_time"]["default_value"]) == "false"
    used = [
        ast.literal_eval(call.args[0])
        for call in calls
        if getattr(call.func, "id", "") == "LaunchConfiguration"
    ]
    assert {"time", "use_sim_time", "preset"} <= set(used)


@pytest.mark.parametrize("time", ["wall", "lockstep"])
def test_the_launch_argument_goes_before_the_parameter_file_of_the_loop(time, tmp_path):
    launched = tmp_path / "launched.yaml"  # as launch writes it
    launched.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"time": time, "clock": False}}}))
    loop = SOURCES / "vo2_control" / "config" / "loop.yaml"
    with bench(["--ros-args", "--params-file", str(loop), "--params-file", str(launched)]) as rig:
        for kind in (PlantNode, ControllerNode):
            assert rig.add(kind).get_parameter("time").value == time
        assert rig.node.count_publishers("/clock") == 0


def test_the_parameter_file_of_the_loop_holds_declared_parameters_with_valid_values():
    content = yaml.safe_load((SOURCES / "vo2_control" / "config" / "loop.yaml").read_text())
    shared = content.pop("/**")["ros__parameters"]
    assert content
    for name, section in content.items():
        records = {record.name: record for record in DECLARED[name.rsplit("/", 1)[-1]]}
        for key, value in {**shared, **section["ros__parameters"]}.items():
            records[key].check(value)


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_the_description_builds_where_ros_2_launch_is_installed(path):
    pytest.importorskip("launch_ros", reason="launch comes with ROS 2 only, not from PyPI")
    spec = importlib.util.spec_from_file_location(path.name.split(".")[0], path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    description = module.generate_launch_description()
    names = {argument.name for argument in description.get_launch_arguments()}
    assert "namespace" in names
    assert all(argument.description for argument in description.get_launch_arguments())
