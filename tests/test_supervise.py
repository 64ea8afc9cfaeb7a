"""`supervise`: what dies or hangs runs again, the loop closes again, and the end of one is the end of all."""

import json
import os
import signal
import subprocess
import time

import pytest
from test_plain_start import installed
from vo2_interface.testing import bench
from wall_loop import CONTROLLER, RATE_HZ, SET_POINT_M


@pytest.fixture
def rig(model_file, tmp_path):
    """A loop in wall time under a supervisor, with this process as its witness."""
    wall = f"-p time:=wall -p rate_hz:={RATE_HZ}"
    gains = " ".join(f"-p {name}:={value}" for name, value in CONTROLLER.items())
    run = [
        f"vo2_plant_sim plant --ros-args {wall} -p true_channels:=true",
        f"vo2_estimation estimator --ros-args --params-file {model_file}",
        f"vo2_control reference --ros-args -p steps.levels_m:=[{SET_POINT_M}] -p steps.hold_s:=1e6",
        f"vo2_control controller --ros-args --params-file {model_file} {wall} {gains}",
    ]
    parameters = tmp_path / "rig.yaml"
    parameters.write_text(json.dumps({"/**": {"ros__parameters": {"run": run, "silence_s": 3.0}}}))
    with bench() as found, (tmp_path / "log").open("w") as log:
        found.hear("/vo2/measurement", ("true_tip_deflection", "heater_current"))
        process = subprocess.Popen(
            [installed("vo2_interface", "supervise"), "--ros-args", "--params-file", str(parameters)],
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            yield found, process
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(30.0)


def pid_of(found, name):
    return int(found.status(f"supervise: vo2/{name}")[1].get("pid", 0))


def closed(found, since=0):
    tip = [values[0] for _, values in found.heard["/vo2/measurement"][since:]][-20:]
    return len(tip) == 20 and all(abs(each - SET_POINT_M) < 4e-6 for each in tip)


@pytest.mark.slow
def test_what_dies_or_hangs_runs_again_and_ends_with_the_supervisor(rig):
    found, process = rig
    found.until(lambda: closed(found), 120.0)
    names = ("plant", "estimator", "reference", "controller")
    # the supervisor may not have told them yet, and a signal to process 0 would end this test itself
    found.until(lambda: all(pid_of(found, name) for name in names), 60.0)
    pids = {name: pid_of(found, name) for name in names}
    for name, number in (("estimator", signal.SIGKILL), ("controller", signal.SIGSTOP)):
        since = len(found.heard["/vo2/measurement"])
        os.kill(pids[name], number)
        found.until(lambda: pid_of(found, name) not in (0, pids[name]), 60.0)  # noqa: B023
        found.until(lambda: closed(found, since + 40), 60.0)  # noqa: B023
        assert any(abs(values[1]) < 1e-4 for _, values in found.heard["/vo2/measurement"][since:]), (
            "never safe"
        )
    others = [pids["plant"], pids["reference"]]
    assert [pid_of(found, name) for name in ("plant", "reference")] == others
    now = [pid_of(found, name) for name in pids]
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 0
    time.sleep(0.2)
    for pid in now:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_who_comes_late_is_told_what_runs(tmp_path):
    parameters = tmp_path / "rig.yaml"
    parameters.write_text(json.dumps({"/**": {"ros__parameters": {"run": ["vo2_control reference"]}}}))
    with bench() as found, (tmp_path / "log").open("w") as log:
        line = [installed("vo2_interface", "supervise"), "--ros-args", "--params-file", str(parameters)]
        process = subprocess.Popen(line, stdout=log, stderr=subprocess.STDOUT)
        try:
            found.until(lambda: pid_of(found, "reference"), 60.0)
            found.statuses.clear()
            found.until(lambda: pid_of(found, "reference"), 10.0)
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(30.0) == 0


def test_what_cannot_be_used_is_told():
    def refused(*arguments):
        line = [
            installed("vo2_interface", "supervise"),
            *(["--ros-args", "-p", *arguments] if arguments else []),
        ]
        ended = subprocess.run(line, capture_output=True, text=True, timeout=60)
        assert ended.returncode == 2, ended.stderr
        return ended.stderr

    assert "run: found no process" in refused()
    assert "found no executable 'plent' of package 'vo2_plant_sim'" in refused('run:=["vo2_plant_sim plent"]')
    assert "vo2/plant twice" in refused('run:=["vo2_plant_sim plant", "vo2_plant_sim plant"]')
