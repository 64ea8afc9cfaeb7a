"""SROS 2: what is shipped for it covers the graph as it is, and nobody joins an enforced graph without keys."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rclpy.node import Node
from rig_template.rig_node import RigNode
from test_plain_start import installed, plain_environment, running
from vo2_control.controller_node import ControllerNode
from vo2_control.feedforward_node import FeedforwardNode
from vo2_control.reference_node import ReferenceNode
from vo2_estimation.estimator_node import EstimatorNode
from vo2_identification.bags import BagWriter
from vo2_identification.identifier_node import IdentifierNode
from vo2_identification.recorder_node import Recorder
from vo2_interface.beam import BeamNode
from vo2_interface.live.node import LiveNode
from vo2_interface.supervise import SuperviseNode
from vo2_interface.testing import bench
from vo2_plant_sim.plant_node import PlantNode

SHIPPED = Path(__file__).parents[1] / "src" / "vo2_interface" / "security"
INCLUDE = "{http://www.w3.org/2001/XInclude}include"
COMMANDERS = {"/vo2/controller", "/vo2/feedforward", "/vo2/identifier"}
KINDS = {
    ("topics", "publish"): "get_publisher_names_and_types_by_node",
    ("topics", "subscribe"): "get_subscriber_names_and_types_by_node",
    ("services", "reply"): "get_service_names_and_types_by_node",
    ("services", "request"): "get_client_names_and_types_by_node",
}
ACTION = {
    ("topics", "publish"): ("feedback", "status"),
    ("services", "reply"): ("send_goal", "get_result", "cancel_goal"),
}
"""What a node that executes an action publishes and replies to."""
HEAR_S = 15.0
COMMAND = """
import rclpy, sys, time
from sensor_msgs.msg import JointState
rclpy.init(args=sys.argv)
node = rclpy.create_node("intruder", namespace="/vo2")
publisher = node.create_publisher(JointState, "/vo2/command", 10)
end = time.monotonic() + 8.0
sample = 0
while time.monotonic() < end:
    message = JointState(name=["heater_current"], position=[0.005])
    message.header.stamp.sec = 1  # where simulated time begins
    message.header.stamp.nanosec = 1_000_000 * (sample % 20)
    publisher.publish(message)
    rclpy.spin_once(node, timeout_sec=0.02)
    sample += 1
"""
LISTEN = f"""
import rclpy, sys, time
from sensor_msgs.msg import JointState
rclpy.init(args=sys.argv)
node = rclpy.create_node("recorder")
stamps = set()
node.create_subscription(JointState, "/vo2/measurement", lambda m: stamps.add(m.header.stamp.nanosec), 10)
end = time.monotonic() + {HEAR_S}
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.05)
print("heard", len(stamps))
"""


def allowed():
    """Enclave -> (kind, way) -> full names that it may use, the files that the policy includes read in their place."""
    found: dict[str, dict[tuple[str, str], set[str]]] = {}
    for enclave in ElementTree.parse(SHIPPED / "policy.xml").getroot().iter("enclave"):
        (profile,) = enclave.iter("profile")
        space, node = profile.attrib["ns"], profile.attrib["node"]
        space = space.rstrip("/")
        assert enclave.get("path") == f"{space}/{node}"
        rules = found.setdefault(f"{space}/{node}", {kind: set() for kind in KINDS})
        parts = list(profile)
        for part in parts:
            if part.tag == INCLUDE:
                parts += list(ElementTree.parse(SHIPPED / part.attrib["href"]).getroot())
                continue
            (way,) = part.attrib
            for name in part:
                text = str(name.text).replace("~", node)
                full = text if text.startswith("/") else f"{space}/{text}"
                if part.tag == "actions":
                    for kind, ends in ACTION.items() if way == "execute" else ():
                        rules[kind] |= {f"{full}/_action/{end}" for end in ends}
                else:
                    rules[part.tag, way].add(full)
    return found


def test_the_shipped_policy_allows_each_node_what_it_does_and_no_other_node_to_command(tmp_path):
    rules = allowed()
    bag = BagWriter(tmp_path / "bag")
    makers: dict[Callable[[], Node], tuple[str, ...]] = {
        **dict.fromkeys((PlantNode, EstimatorNode, ReferenceNode, ControllerNode), ()),
        **dict.fromkeys((FeedforwardNode, IdentifierNode, BeamNode), ()),
        SuperviseNode: ("-p", "run:=['vo2_control reference']"),
        LiveNode: ("-p", "port:=0"),
        RigNode: ("-p", "autostart:=false"),
        (lambda: Recorder(bag)): (),
    }
    looked_at = set()
    for make, parameters in makers.items():
        with bench(["--ros-args", *parameters] if parameters else []) as rig, ExitStack() as ends:
            node = rig.add(make)
            if isinstance(node, SuperviseNode):
                ends.callback(
                    node.close
                )  # what it has started would live on, and speak in the domain of a later test
            name, space = node.get_name(), node.get_namespace()
            rig.until(lambda: (name, space) in rig.node.get_node_names_and_namespaces())  # noqa: B023
            rig.spin(0.3)
            looked_at.add(enclave := f"{space.rstrip('/')}/{name}")
            for kind, asked in KINDS.items():
                used = {each for each, _ in getattr(rig.node, asked)(name, space)}
                assert used <= rules[enclave][kind], (name, kind)
    bag.close()
    assert looked_at == set(rules) - {"/vo2/operator"}
    may_command = {path for path, own in rules.items() if "/vo2/command" in own["topics", "publish"]}
    assert may_command == COMMANDERS
    called = rules["/vo2/operator"]["services", "request"]
    replied = set().union(*(own["services", "reply"] for own in rules.values()))
    assert called <= replied and {"/vo2/identifier/start", "/vo2/plant/emergency_stop"} <= called


@pytest.mark.parametrize(
    ("package", "executable"), [("vo2_plant_sim", "plant"), ("vo2_control", "controller")]
)
def test_a_node_without_keys_does_not_join_an_enforced_graph(tmp_path, package, executable):
    """Neither with a Fast DDS that has the security plug-in nor with one that has not."""
    (tmp_path / "enclaves" / "vo2" / executable).mkdir(parents=True)
    environment = {**plain_environment(), **enforced(tmp_path)}
    command = [installed(package, executable), "--ros-args", "--enclave", f"/vo2/{executable}"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    (line,) = [text for text in done.stderr.splitlines() if text.startswith(executable)]
    assert re.search("cannot join the graph: .*secur", line, re.IGNORECASE)
    assert "Traceback" not in done.stderr


def test_keys_are_not_made_without_the_tools_of_ros(tmp_path):
    def made(*arguments):
        path = {"PATH": "/usr/bin:/bin"}
        return subprocess.run(
            ["/bin/sh", str(SHIPPED / "make_keys.sh"), *arguments], env=path, capture_output=True, text=True
        )

    few, without = made(), made(str(tmp_path / "keys"))
    assert few.returncode == 2 and "found 0 arguments" in few.stderr
    assert without.returncode == 2 and "found no 'ros2 security'" in without.stderr
    assert not (tmp_path / "keys").exists()


def enforced(keys):
    """Variables of a process that joins with these keys, or not at all."""
    names = ("ROS_SECURITY_KEYSTORE", "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY")
    return dict(zip(names, (str(keys), "true", "Enforce"), strict=True))


def has_security():
    """Whether there are the tools for keys, and a Fast DDS that was built with its plug-in."""
    if (
        not shutil.which("ros2")
        or subprocess.run(["ros2", "security", "--help"], capture_output=True).returncode
    ):
        return False
    join = "import rclpy; rclpy.init(); rclpy.create_node('x')"
    environment = {**plain_environment(), **enforced("/nowhere")}
    tried = subprocess.run([sys.executable, "-c", join], env=environment, capture_output=True, text=True)
    return "doesn't have the security libraries" not in tried.stderr


@pytest.mark.parametrize("security", [False, True], ids=["open", "enforced"])
@pytest.mark.parametrize("keys_of", ["nobody", "operator"])
def test_who_has_no_right_to_command_moves_no_current(tmp_path, security, keys_of):
    """Lockstep: the plant gives its next sample for a command. In an open graph the intruder is obeyed, which shows the test."""
    if security and not has_security():
        pytest.skip("needs sros2 and a Fast DDS with its security plug-in: the wheels have neither")
    environment = plain_environment()
    keys, own = tmp_path / "keys", {}
    if security:
        subprocess.run([SHIPPED / "make_keys.sh", keys], check=True, timeout=60)
        own = enforced(keys)

    def enclave(name):
        return ["--ros-args", "--enclave", name] if security else []

    intruder = enclave("/vo2/operator") if keys_of == "operator" else []
    with running(
        [installed("vo2_plant_sim", "plant"), *enclave("/vo2/plant")], {**environment, **own}
    ) as plant:
        listener = [sys.executable, "-c", LISTEN, *enclave("/recorder")]
        with running(listener, {**environment, **own}) as ear:
            time.sleep(2.0)
            theirs = own if keys_of == "operator" else {}
            with running([sys.executable, "-c", COMMAND, *intruder], {**environment, **theirs}) as other:
                told = ear.communicate(timeout=HEAR_S + 60.0)[0]
                assert other.wait(60.0) == 0 or security
        assert plant.poll() is None
    heard = int(told.split("heard")[1])
    assert heard == 1 if security else heard > 1
