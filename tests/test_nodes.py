"""Every executable: parameters from a model file at start and at run time, bad input, missing input."""

import subprocess
import sys

import pytest
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from vo2_interface.parameters import ros_parameters
from vo2_models.model_file import load_model_parameters
from vo2_models.parameters import Value
from vo2_studies.demo.graph import MODULES

NODES = ("plant", "estimator", "controller", "reference", "feedforward", "identifier")


def _first_alone(cases):
    """Cases that take the same way through one function of all nodes: those after the first are slow."""
    first, *others = cases
    return [pytest.param(*first), *(pytest.param(*each, marks=pytest.mark.slow) for each in others)]


def test_every_node_gives_all_its_parameters_and_takes_a_model_file_at_start_and_at_run_time(
    graph, conductor, model_file
):
    names = {f"{node}_{when}": node for node in NODES for when in ("at_start", "at_run_time")}
    for name, node in names.items():
        file = model_file if name.endswith("at_start") else None
        # simulated time stands: nothing is asked of a loop that runs as fast as it can
        stands: dict[str, Value] = {"run_until_s": 1.0} if node == "plant" else {}
        graph.start(node, name=name, parameters=stands, parameter_file=file)
    conductor.wait_for_nodes([f"/vo2/{name}" for name in names])
    # as `ros2 param load` does it: one request with all parameters, each accepted or refused alone
    request = SetParameters.Request()
    request.parameters = [
        parameter.to_parameter_msg() for parameter in ros_parameters(load_model_parameters(model_file))
    ]
    for name in names:
        # as `ros2 param dump` asks, which has no answer at all where a single one is without a value
        listing = conductor.call(f"/vo2/{name}/list_parameters", ListParameters, ListParameters.Request())
        asked = GetParameters.Request(names=listing.result.names)
        values = conductor.call(f"/vo2/{name}/get_parameters", GetParameters, asked).values
        assert len(values) == len(asked.names) > 50, name
        if name.endswith("at_start"):
            continue
        results = conductor.call(f"/vo2/{name}/set_parameters", SetParameters, request).results
        assert len(results) == len(request.parameters)
        assert [result.reason for result in results if not result.successful] == [], name
    graph.check()


def test_a_parameter_that_no_node_has_ends_with_what_may_be_meant(graph):
    ended = subprocess.run(
        [sys.executable, "-m", MODULES["controller"], "--ros-args", "-p", "limits.uper_a:=0.001"],
        env=graph.environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode == 2
    last = ended.stderr.strip().splitlines()[-1]
    assert last.endswith("limits.uper_a: no such parameter; did you mean limits.upper_a?")


@pytest.mark.parametrize(
    ("executable", "parameter", "message"),
    [
        *_first_alone((node, "preset:=foo", "need one of integrated, peltier") for node in NODES),
        ("plant", "rate_hz:=-1.0", "rate_hz: need a number with a decimal point, 0 to 20000 Hz"),
        ("plant", "effects:='{antigravity: {g: 1}}'", "antigravity"),
        ("plant", "source:=model", "source: found model, need model.* parameters"),
        ("controller", "kind:=bang_bang", "kind: need one of"),
        ("reference", "steps.levels_m:=[0.5]", "steps.levels_m: found 0.5 m, need at most 0.00057"),
        ("controller", "limits.upper_a:=0.02", "limits.upper_a: found 0.02 A"),
        ("estimator", "model.thermal.time_constant:=-1.0", "model.thermal.time_constant"),
    ],
)
def test_a_bad_parameter_ends_with_one_line_and_status_2(graph, executable, parameter, message):
    ended = subprocess.run(
        [sys.executable, "-m", MODULES[executable], "--ros-args", "-p", parameter],
        env=graph.environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode == 2
    assert message in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("executable", [*_first_alone((node,) for node in NODES), "loop"])
def test_an_unknown_option_is_refused_and_help_is_given(graph, executable):
    for option, status in (("--speed", 2), ("--help", 0)):
        ended = subprocess.run(
            [sys.executable, "-m", MODULES[executable], option],
            env=graph.environment(),
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert ended.returncode == status
        assert "--ros-args" in (ended.stderr if status else ended.stdout)
        if not status:
            assert f"`{executable}`: " in ended.stdout and "Parameters:" in ended.stdout


def test_the_demo_refuses_an_output_folder_it_cannot_write(graph, tmp_path):
    (tmp_path / "file").write_text("")
    ended = subprocess.run(
        [sys.executable, "-m", "vo2_studies.demo", "--output", str(tmp_path / "file" / "demo")],
        env=graph.environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode == 2
    assert "cannot be written" in ended.stderr
    assert "--output" in ended.stderr


def test_a_composed_loop_runs_in_one_process_and_identifies(graph, conductor, tmp_path):
    graph.start("loop", arguments=["--with-reference"], parameters={"seed": 2})
    graph.start("identifier", parameters={"excitation.level": 14, "model_file": str(tmp_path / "model.yaml")})
    conductor.wait_for_nodes(["/vo2/identifier", "/vo2/plant", "/vo2/estimator", "/vo2/controller"])
    conductor.set("/vo2/controller", {"enabled": False})
    conductor.trigger("/vo2/identifier/start")
    conductor.wait_for(
        "the model", lambda: conductor.value("vo2/identifier: progress", "state") in ("done", "failed"), 90.0
    )
    assert conductor.value("vo2/identifier: progress", "state") == "done", conductor.statuses
    assert load_model_parameters(tmp_path / "model.yaml")["model.device"] == "integrated"
    conductor.set("/vo2/controller", {"enabled": True})
    conductor.wait_for("a closed loop", lambda: _told(conductor, "vo2/controller: input", "closed"), 20.0)


def test_an_identification_can_be_cancelled_and_started_again(graph, conductor):
    graph.start("identifier")
    conductor.wait_for_nodes(["/vo2/identifier"])
    assert "damped_oscillation" in conductor.trigger("/vo2/identifier/start")
    assert "cancelled" in conductor.trigger("/vo2/identifier/cancel")
    assert "damped_oscillation" in conductor.trigger("/vo2/identifier/start")


def _told(conductor, status, text):
    return status in conductor.statuses and text in conductor.statuses[status][1]
