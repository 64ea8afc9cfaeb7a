"""The composed loop: nodes of other packages in it, and all of it on simulated time."""

import pytest
from vo2_control.controller_node import ControllerNode
from vo2_control.reference_node import ReferenceNode
from vo2_estimation.estimator_node import EstimatorNode
from vo2_interface.testing import bench
from vo2_plant_sim.plant_node import PlantNode

from vo2_control import loop_node

OWN = """
from rclpy.node import Node

class Own(Node):
    def __init__(self):
        super().__init__("own")

class Needy(Node):
    def __init__(self, what):
        super().__init__("needy")

number = 1
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Name of an installed module with a node."""
    (tmp_path / "own_package_node.py").write_text(OWN)
    (tmp_path / "own_package_broken.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(str(tmp_path))
    return "own_package_node"


def test_a_node_of_another_package_joins_the_loop(module, monkeypatch):
    ran = {}

    def run_nodes(*nodes, args):
        ran.update(nodes=nodes, args=args)
        return 0

    monkeypatch.setattr(loop_node, "run_nodes", run_nodes)
    line = ["loop", "--without-plant", "--with", f"{module}:Own", "--ros-args", "-p", "seed:=2"]
    assert loop_node.main(line) == 0
    assert ran["args"] == ["loop", "--ros-args", "-p", "seed:=2"]
    estimator, controller, own = ran["nodes"]
    assert (estimator, controller) == (EstimatorNode, ControllerNode)
    with bench() as rig:
        assert rig.add(own).get_name() == "own"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        (":Own", "cannot be imported"),
        ("no_such_module:Own", "No module named 'no_such_module'"),
        ("own_package_broken:Own", "division by zero"),
        ("own_package_node", "cannot be imported"),
        ("own_package_node:Other", "has no attribute 'Other'"),
        ("own_package_node:number", "is no class of a node"),
        ("own_package_node:Needy", "missing a required argument: 'what'"),
    ],
)
def test_what_is_no_node_is_one_line_and_status_2(module, name, why, capsys):
    assert loop_node.main(["loop", "--with", name]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"loop: --with {name}: ") and why in told
    assert len(told.splitlines()) == 1


def test_a_whole_loop_follows_the_clock_that_its_plant_publishes():
    with bench(["--ros-args", "-p", "use_sim_time:=true", "-p", "seed:=2"]) as rig:
        rig.hear("/vo2/command", ("heater_current",))
        nodes = [rig.add(each) for each in (EstimatorNode, ControllerNode, ReferenceNode, PlantNode)]
        rig.until(lambda: len(rig.heard["/vo2/command"]) > 200)
        # the clock goes on every 10 ms, from 1 s on
        rig.until(lambda: all(0 < node.get_clock().now().nanoseconds < 10**12 for node in nodes))
    stamps = sorted({stamp for stamp, _ in rig.heard["/vo2/command"]})
    assert stamps == [10**9 + k * 10**6 for k in range(len(stamps))]
