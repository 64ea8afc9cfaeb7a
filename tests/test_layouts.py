"""What is shipped for Foxglove, PlotJuggler and RViz names topics and channels of the running graph, and bends the beam."""

import json
import math
import re
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import pytest
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import JointState
from vo2_control.controller_node import ControllerNode
from vo2_control.reference_node import ReferenceNode
from vo2_estimation.estimator_node import EstimatorNode
from vo2_interface.beam import BeamNode, tip_pose
from vo2_interface.testing import bench
from vo2_interface.topics import READ_QOS, SAMPLE_QOS
from vo2_models.device.description import preset
from vo2_plant_sim.plant_node import PlantNode

SHARE = Path(__file__).resolve().parents[1] / "src" / "vo2_interface"
FIELD = re.compile(r"(/vo2/\w+)\.position\[(\d)\]$")


@pytest.fixture(scope="module")
def channels():
    """Topic -> names of its channels, of a loop that runs."""
    found: dict[str, list[str]] = {}

    def hear(message: JointState, topic: str) -> None:
        found.setdefault(topic, list(message.name))

    with bench(["--ros-args", "-p", "run_until_s:=1.1"]) as rig:
        for role in ("measurement", "estimate", "reference", "command"):
            topic = f"/vo2/{role}"
            rig.node.create_subscription(JointState, topic, partial(hear, topic=topic), READ_QOS)
        for kind in (EstimatorNode, ControllerNode, ReferenceNode, BeamNode, PlantNode):
            rig.add(kind)
        rig.until(lambda: len(found) == 4)
        topics = {name for name, _ in rig.node.get_topic_names_and_types()}
    return found, topics


def test_foxglove(channels):
    names, topics = channels
    layout = json.loads((SHARE / "layouts" / "foxglove.json").read_text())
    shown = []
    for panel in layout["configById"].values():
        for path in panel.get("paths", []):
            ((topic, place),) = FIELD.findall(path["value"])
            assert path["label"] == f"{topic.rsplit('/', 1)[-1]} {names[topic][int(place)]}"
            shown.append(path["value"])
        for topic in (*panel.get("topics", {}), panel.get("topicToRender", "/vo2/tip")):
            assert topic in topics
    assert len(shown) == 8
    assert FIELD.match(layout["configById"]["Plot!loop"]["xAxisPath"]["value"])
    tiles = json.dumps(layout["layout"])
    assert all(f'"{panel}"' in tiles for panel in layout["configById"])


def test_plotjuggler(channels):
    names, _ = channels
    layout = ElementTree.parse(SHARE / "layouts" / "plotjuggler.xml")
    curves = [str(curve.get("name")) for curve in layout.iter("curve")]
    assert len(curves) == 7
    for curve in curves:
        topic, channel, field = curve.rsplit("/", 2)
        assert (channel in names[topic], field) == (True, "position"), curve


def attribute(joint: ElementTree.Element, child: str, name: str) -> str:
    found = joint.find(child)
    assert found is not None
    return found.attrib[name]


def test_the_description_bends_its_tip_to_the_deflection():
    robot = ElementTree.parse(SHARE / "urdf" / "cantilever.urdf").getroot()
    joints = {attribute(joint, "child", "link"): joint for joint in robot.iter("joint")}
    leader = joints["tip_at_true_size"].get("name")
    assert leader == "tip_deflection"
    links, link = [], "beam_tip"
    while link != "vo2_base":
        links.append(link)
        link = attribute(joints[link], "parent", "link")
    length = 1000.0 * preset("integrated").length
    for deflection in (0.0, 20e-6, 58e-6):
        x = z = slope = 0.0
        for link in reversed(links):
            joint = joints[link]
            step = float(attribute(joint, "origin", "xyz").split()[0])
            x, z = x + step * math.cos(slope), z + step * math.sin(slope)
            if joint.get("type") == "revolute":
                assert attribute(joint, "axis", "xyz") == "0 -1 0"
                assert attribute(joint, "mimic", "joint") == leader
                slope += float(attribute(joint, "mimic", "multiplier")) * deflection
        assert z == pytest.approx(1000.0 * deflection, rel=0.02, abs=1e-9)
        assert x == pytest.approx(length, rel=0.02)
        assert slope == pytest.approx(tip_pose(deflection, length / 1000.0)[1], rel=0.1, abs=1e-9)


def test_the_tip_as_a_frame():
    with bench(["--ros-args"]) as rig:
        heard: list[TransformStamped] = []
        rig.node.create_subscription(TransformStamped, "/vo2/tip", heard.append, SAMPLE_QOS)
        rig.add(BeamNode)
        for k, value in enumerate((40e-6, 41e-6, math.nan, 20e-6)):
            rig.say("/vo2/measurement", (1 + 15 * k) * 1_000_000, {"tip_deflection": value})
        rig.until(lambda: len(heard) == 2)
        first, last = (message.transform for message in heard)
        assert heard[0].header.frame_id == "vo2_base" and heard[0].child_frame_id == "vo2_tip"
        assert (first.translation.z, last.translation.z) == pytest.approx((0.04, 0.02))
        assert -2.0 * math.asin(first.rotation.y) == pytest.approx(2.0 * 40e-6 / preset("integrated").length)
        rig.say("/vo2/measurement", 1_000_000, {"tip_deflection": 30e-6})
        rig.spin(0.2)
        assert len(heard) == 2
