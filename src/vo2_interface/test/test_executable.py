"""What every node relies on: a queue as long as it asks for, and an end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from vo2_interface.one_host import free_domain
from vo2_interface.testing import bench

STUCK = """
import ctypes
from vo2_interface import executable

executable._LEAVE_S = 0.5


class Stuck:
    def destroy_node(self):
        ctypes.PyDLL(None).sleep(60)  # as a C extension that never gives Python's lock back


executable.leave_graph(None, [Stuck()])
print("left")
"""


def test_a_process_that_cannot_leave_is_ended_and_says_where_it_hung():
    done = subprocess.run(
        [sys.executable, "-c", STUCK], capture_output=True, text=True, timeout=50, check=False
    )
    assert done.returncode == 1
    assert "Timeout" in done.stderr
    assert "destroy_node" in done.stderr
    assert "left" not in done.stdout


MANY = """
import sys, time
from rclpy.node import Node
from vo2_interface import executable
from vo2_interface.timers import create_steady_timer

executable._LEAVE_S = 0.5


class Slow(Node):
    def __init__(self):
        super().__init__("slow", namespace=f"/n{len(made)}")
        made.append(self)
        create_steady_timer(self, 3600.0, lambda: None)
        if len(made) == 12:
            create_steady_timer(self, 0.1, lambda: print("turned", flush=True))

    def destroy_node(self):
        time.sleep(0.1)
        super().destroy_node()


made = []
sys.exit(executable.run_nodes(*[Slow] * 12, args=["many"]))
"""


def test_many_nodes_may_leave_slowly_one_by_one_and_nothing_is_said_of_their_timers():
    environment = dict(os.environ, ROS_DOMAIN_ID=str(free_domain()))
    with subprocess.Popen(
        [sys.executable, "-c", MANY],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        text=True,
    ) as process:
        assert process.stdout.readline() == "turned\n"
        process.send_signal(signal.SIGINT)
        rest, errors = process.communicate(timeout=50)
    assert process.returncode == 0, errors
    assert set(rest.splitlines()) <= {"turned"}


CRASH = """
import ctypes

from vo2_interface.testing import bench


def test_that_crashes():
    with bench():
        ctypes.string_at(0)
"""


def test_a_crash_under_pytest_names_the_test_and_shows_the_stacks(tmp_path):
    (tmp_path / "test_crash.py").write_text(CRASH)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-p", "no:cacheprovider", tmp_path / "test_crash.py"],
        capture_output=True, text=True, timeout=50, check=False,
    )  # fmt: skip
    assert done.returncode == -signal.SIGSEGV
    assert done.stdout.rstrip().endswith("test_crash.py::test_that_crashes")
    assert "Segmentation fault" in done.stderr
    assert "in test_that_crashes" in done.stderr


def test_test_runs_beside_each_other_have_domains_of_their_own():
    """Three take many and hold the last ten, as this one does, and keep a first one; other runs on this machine are unknown."""
    own = {free_domain() for _ in range(10)}
    taken = (
        "from vo2_interface.one_host import free_domain as f; own = f(keep=True); "
        "print(own, *[f() for _ in range(100)][-10:], flush=True); input()"
    )
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", taken], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    try:
        held = [[int(word) for word in run.stdout.readline().split()] for run in runs]
    finally:
        for run in runs:
            run.communicate("\n", timeout=50)
    assert len(own) == 10 and all(len(set(domains)) == 11 for domains in held)
    assert len(own.union(*held)) == 43
    assert [run.returncode for run in runs] == [0, 0, 0]


def test_a_subscription_keeps_as_many_samples_as_it_asks_for():
    count = 9000  # more than Fast DDS keeps by itself, fewer than READ_QOS asks for
    with bench() as rig:
        rig.hear("/vo2/measurement", ("heater_current",))
        for k in range(count):
            rig.say("/vo2/measurement", k, {"heater_current": 1e-3})
        rig.until(lambda: len(rig.heard["/vo2/measurement"]) == count)
