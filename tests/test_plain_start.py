"""Nodes started as anybody starts them, with nothing set in the shell: loopback only, heard by plain ROS 2, no loss."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from vo2_interface.one_host import free_domain, missing_settings

SETTINGS = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "FASTRTPS_DEFAULT_PROFILES_FILE")
PATIENCE_S = 60.0
LISTEN = """
import sys, rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node("plain")
heard = []
node.create_subscription(JointState, "/vo2/measurement", heard.append, 10)
while len(heard) < 3:
    rclpy.spin_once(node)
print("heard", heard[0].name)
"""


def plain_environment():
    """What a shell gives that has sourced the workspace, on a domain of this test's own."""
    kept = {name: value for name, value in os.environ.items() if name not in SETTINGS}
    return {**kept, "ROS_DOMAIN_ID": str(free_domain())}


def installed(package, executable):
    """The entry point as `ros2 run` finds it."""
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        path = Path(prefix) / "lib" / package / executable
        if path.exists():
            return str(path)
    raise FileNotFoundError(f"{package} {executable}: build and source the workspace first")


@contextmanager
def running(command, environment):
    """Run a command for the length of the context; whatever happens, it is gone afterwards."""
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=10)


def open_files(pid):
    """What the descriptors of a process point to."""
    links = []
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            links.append(os.readlink(descriptor))
        except FileNotFoundError:  # closed meanwhile
            continue
    return links


def bound_addresses(pid):
    """IP addresses that the sockets of a process are bound to, as `ss -anp` shows them: (hex address, port)."""
    inodes = {link[8:-1] for link in open_files(pid) if link.startswith("socket:[")}
    found = set()
    for table in ("udp", "udp6", "tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes:
                found.add(tuple(fields[1].split(":")))
    return found


def wait_for(condition, what):
    deadline = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what} did not happen in {PATIENCE_S} s")
        time.sleep(0.05)
    return found


@pytest.mark.parametrize(
    "command",
    [
        lambda: [installed("vo2_plant_sim", "plant")],
        lambda: [sys.executable, "-m", "vo2_plant_sim.plant_node"],
        lambda: [installed("vo2_identification", "record"), "--output"],
    ],
    ids=["entry point", "python -m", "record"],
)
def test_every_socket_is_on_the_loopback_interface(command, tmp_path):
    line = command()
    line += [str(tmp_path / "bag")] if line[-1] == "--output" else []
    with running(line, plain_environment()) as node:
        found = wait_for(lambda: bound_addresses(node.pid), "a socket")
        time.sleep(1.0)
        found |= bound_addresses(node.pid)
        assert {address for address, _ in found} == {
            "0100007F"
        }  # 127.0.0.1 in the byte order of this machine
        node.send_signal(signal.SIGINT)
        assert node.wait(PATIENCE_S) == 0


@pytest.mark.parametrize("time_base", ["lockstep", "wall"])
def test_nobody_waits_for_the_shared_memory_of_another(time_base):
    # as a process gets it from one that has taken our settings
    environment = {**plain_environment(), **missing_settings({})}
    how = ["-p", f"time:={time_base}", "-p", "rate_hz:=40.0"]
    with running([installed("vo2_plant_sim", "plant"), "--ros-args", *how], environment) as node:
        found = wait_for(lambda: bound_addresses(node.pid), "a socket")
        time.sleep(1.0)
        assert {address for address, _ in found | bound_addresses(node.pid)} == {"0100007F"}
        assert "/dev/shm/fastrtps" not in Path(f"/proc/{node.pid}/maps").read_text()
        assert node.poll() is None


def test_one_variable_opens_the_graph_to_the_network():
    environment = {**plain_environment(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    with running([installed("vo2_plant_sim", "plant")], environment) as node:
        wait_for(
            lambda: "00000000" in {address for address, _ in bound_addresses(node.pid)}, "an open socket"
        )


def test_what_the_user_has_set_stays():
    assert set(missing_settings({})) == {"ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"}
    chosen = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "FASTRTPS_DEFAULT_PROFILES_FILE": "own.xml"}
    assert missing_settings(chosen) == {}
    assert missing_settings({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}).keys() == {
        "FASTRTPS_DEFAULT_PROFILES_FILE"
    }


def test_a_program_without_our_settings_hears_the_nodes():
    environment = plain_environment()
    with running([installed("vo2_plant_sim", "plant")], environment):
        listener = subprocess.run(
            [sys.executable, "-c", LISTEN],
            env=environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )
    assert "film_resistance" in listener.stdout, listener.stderr


@pytest.mark.alone
@pytest.mark.parametrize("samples", [3_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_three_processes_and_a_recorder_at_1_khz_lose_nothing(tmp_path, samples):
    environment = plain_environment()
    topics = [f"/vo2/{role}" for role in ("measurement", "estimate", "reference")]
    bag = str(tmp_path / "bag")
    record = [installed("vo2_identification", "record"), "--output", bag, "--messages", str(3 * samples)]
    record += [
        "--gap-limit",
        "100",
    ]  # a slow host's plant leaves periods out; what is asked is that none that was sent is lost
    parameters = ["--ros-args", "-p", "time:=wall", "-p", "rate_hz:=1000.0"]
    with (
        running([*record, "--topics", *topics], environment) as recorder,
        running([installed("vo2_estimation", "estimator")], environment),
        running([installed("vo2_control", "reference")], environment),
        running([installed("vo2_plant_sim", "plant"), *parameters], environment),
    ):
        said, _ = recorder.communicate(timeout=PATIENCE_S + samples / 200)
    print(said)
    assert recorder.returncode == 0, said
    assert "did not arrive" not in said
    counts = {topic: int(count) for topic, count in re.findall(r"(/vo2/\w+) (\d+)[,)]", said)}
    assert counts.keys() == set(topics)
    assert sum(counts.values()) == 3 * samples


def test_a_recorder_that_stands_still_for_almost_half_a_second_loses_nothing_at_1_khz(tmp_path):
    """What a publisher keeps (100 samples) is over by then: the queue of its socket has to hold the rest."""
    environment = plain_environment()
    record = [
        installed("vo2_identification", "record"),
        "--output",
        str(tmp_path / "bag"),
        "--messages",
        "2500",
    ]
    plant = [installed("vo2_plant_sim", "plant"), "--ros-args", "-p", "time:=wall", "-p", "rate_hz:=1000.0"]
    with (
        running([*record, "--topics", "/vo2/measurement"], environment) as recorder,
        running(plant, environment),
    ):
        wait_for(lambda: sum(path.stat().st_size for path in tmp_path.rglob("*.mcap")), "a sample in the bag")
        for _ in range(3):
            recorder.send_signal(signal.SIGSTOP)
            time.sleep(0.4)
            recorder.send_signal(signal.SIGCONT)
            time.sleep(0.2)
        said, _ = recorder.communicate(timeout=PATIENCE_S)
    assert "Recorded 2500 messages" in said
    assert "did not arrive" not in said


@pytest.mark.parametrize(
    ("executable", "cold"),
    [
        pytest.param("plant", False, id="plant, warm", marks=pytest.mark.slow),
        pytest.param("plant", True, id="plant, cold kernels"),
        pytest.param("estimator", False, id="estimator, warm"),
        pytest.param("estimator", True, id="estimator, cold kernels", marks=pytest.mark.slow),
    ],
)
def test_one_ctrl_c_or_two_end_a_node_in_order(tmp_path, executable, cold):
    package = {"plant": "vo2_plant_sim", "estimator": "vo2_estimation"}[executable]
    environment = {**plain_environment(), "PYTHONUNBUFFERED": "1"}
    if cold:
        environment["VO2_KERNEL_CACHE"] = str(tmp_path)
    for delay_s, again_s in ((0.0, None), (0.3, 0.05), (1.5, 0.5)):
        with running([installed(package, executable)], environment) as node:
            # from here on it hears signals: what is imported before takes a second
            wait_for(lambda node=node: catches_sigint(node.pid), "a handler")
            time.sleep(delay_s)
            began = time.monotonic()
            node.send_signal(signal.SIGINT)
            if again_s is not None:
                time.sleep(again_s)
                if node.poll() is None:
                    node.send_signal(signal.SIGINT)
            said, _ = node.communicate(timeout=PATIENCE_S)
        assert node.returncode == 0, said
        assert "Traceback" not in said
        assert time.monotonic() - began < 10.0


def test_a_controller_that_keeps_wall_time_designs_in_a_process_beside_it(model_file):
    """The executable itself, not the module: what it spawns loads its script again, and must not become a second controller."""
    command = [installed("vo2_control", "controller"), "--ros-args", "-p", "time:=wall", "--params-file"]
    with running([*command, str(model_file)], plain_environment()) as node:
        designer = Path(f"/proc/{node.pid}/task/{node.pid}/children")
        wait_for(designer.read_text, "a process that designs")
        time.sleep(5.0)  # it loads what it designs with
        assert designer.read_text(), "the process that designs has ended"
        node.send_signal(signal.SIGINT)
        said, _ = node.communicate(timeout=PATIENCE_S)
    assert "Traceback" not in said, said
    assert said.count("lifecycle: active") == 1
    assert node.returncode == 0


def catches_sigint(pid):
    """Whether the program itself handles SIGINT and SIGTERM: Python alone handles the first only."""
    status = Path(f"/proc/{pid}/status").read_text()
    (mask,) = re.findall(r"SigCgt:\s*(\w+)", status)
    caught = int(mask, 16)
    return all(caught >> (number - 1) & 1 for number in (signal.SIGINT, signal.SIGTERM))
