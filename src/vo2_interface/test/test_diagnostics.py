"""What a node says in the log names the place that says it."""

import os
import subprocess
import sys
import time

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.samples import SampleWriter
from vo2_interface.testing import bench
from vo2_interface.topics import DIAGNOSTICS, SAMPLE_QOS

FLAPS = """
from diagnostic_msgs.msg import DiagnosticArray
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.testing import bench
from vo2_interface.topics import SAMPLE_QOS
from std_msgs.msg import Bool

with bench() as rig:
    diagnostics = Diagnostics(rig.node)
    diagnostics.watch_listeners(rig.node.create_publisher(Bool, "other", SAMPLE_QOS))
    for k in range(401):
        diagnostics.report("input", "warn" if k % 2 else "ok", "lost" if k % 2 else "there")
    before = len(rig.statuses)
    rig.spin(1.2)
    print(len([text for name, text, _ in rig.statuses if name.endswith("input")]), rig.status("input")[0])
"""


def test_two_states_that_alternate_are_no_flood_and_the_newest_is_told(tmp_path):
    program = tmp_path / "flaps.py"
    program.write_text(FLAPS)
    done = subprocess.run(
        [sys.executable, str(program)], capture_output=True, text=True, timeout=120, check=True
    )
    count, words = done.stdout.split()
    assert 8 < int(count) < 40 and words == "there"
    lost = [line for line in done.stderr.splitlines() if "input: lost" in line]
    assert len(lost) == 8 + 4 and lost[-1].endswith("(128 times)")


SAYS = """
from vo2_interface.diagnostics import Diagnostics
from vo2_interface.testing import bench

with bench() as rig:
    diagnostics = Diagnostics(rig.node)
    # one place in the code, every severity: rclpy refuses a place that changes its own
    for level in ("ok", "warn", "error", "ok"):
        diagnostics.report("model", level, f"as {level}")
    diagnostics.count("model", "too many")
"""


def test_a_log_line_names_the_file_and_the_line_that_report(tmp_path):
    """In a process of its own: the format is read once in a process."""
    program = tmp_path / "says.py"
    program.write_text(SAYS)
    said = subprocess.run(
        [sys.executable, str(program)],
        env={
            **os.environ,
            "RCUTILS_CONSOLE_OUTPUT_FORMAT": "{file_name}:{line_number}: {severity}: {message}",
        },
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    ).stderr.splitlines()
    levels = (("INFO", "as ok"), ("WARN", "as warn"), ("ERROR", "as error"), ("INFO", "as ok"))
    place = f"{program.resolve()}:9"
    assert said[:4] == [f"{place}: {severity}: model: {text}" for severity, text in levels]
    assert said[4] == f"{program.resolve()}:10: WARN: model: too many"


@pytest.mark.parametrize(
    ("arguments", "wall_time"),
    [([], False), (["--ros-args", "-p", "use_sim_time:=true"], False), ([], True)],
    ids=["lockstep", "use_sim_time", "wall"],
)
def test_what_is_told_before_the_first_sample_has_no_stamp_of_another_clock(arguments, wall_time):
    stamps = []
    with bench(arguments) as rig:
        rig.node.create_subscription(
            DiagnosticArray, DIAGNOSTICS, lambda told: stamps.append(told.header.stamp.sec), SAMPLE_QOS
        )
        rig.until(lambda: rig.node.count_subscribers(DIAGNOSTICS) == 2)
        diagnostics = Diagnostics(rig.node, wall_time=wall_time)
        rig.until(lambda: diagnostics._publisher.get_subscription_count() == 2)
        diagnostics.report("signal", "ok", "steps")
        diagnostics.note_sample(SampleWriter(("film_resistance",)).write(7 * 10**9, (1e5,)))
        diagnostics.report("signal", "ok", "sines")
        rig.until(lambda: len(stamps) == 2)
    before, after = stamps
    assert after == 7
    assert abs(before - time.time()) < 600 if wall_time else before == 0
