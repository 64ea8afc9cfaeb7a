"""Ctrl-C while a challenge draws cases and writes bags, and while a case runs."""

import signal
import subprocess
import sys
import time

import pytest


@pytest.mark.parametrize(
    ("command", "begun", "told"),
    [
        (["", "--cases", "500", "--seed", "3", "--bags-only"], "answers/0000.json", ""),
        ([".days", "--cases", "2", "--samples", "2500"], "cases/0000/fit.log", "none    0 cases"),
    ],
)
def test_ctrl_c_ends_a_study_with_one_line(tmp_path, command, begun, told):
    module, *options = command
    process = subprocess.Popen(
        [sys.executable, "-m", f"vo2_studies.challenge{module}", *options, "--output", str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 120
        while not (tmp_path / "out" / begun).exists() and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        output, error = process.communicate(timeout=30)
    finally:
        process.kill()
    # CPython ends by the signal itself where it fell into exec() of a string, handled or not; a shell tells both as 130
    assert process.returncode in (130, -signal.SIGINT)
    assert error.splitlines()[-1] == "interrupted; finished cases are kept, the same command continues"
    assert "Traceback" not in error and told in output
