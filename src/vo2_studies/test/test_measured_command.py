"""The command `measured`: what it says to bad input and to Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from vo2_studies.measured.command import main

MEASURED = Path(__file__).resolve().parents[4] / "shared" / "data"


def test_bad_input_is_one_line(tmp_path, capsys):
    assert main(["--output", str(tmp_path), "--data", str(tmp_path / "nowhere")]) == 2
    assert "nowhere, need the measured recordings" in capsys.readouterr().err
    assert main(["--output", str(tmp_path), "--data", str(tmp_path)]) == 2
    assert "found none of" in capsys.readouterr().err


@pytest.mark.skipif(not MEASURED.is_dir(), reason="needs ../shared/data beside the repository")
def test_no_jobs_is_refused(tmp_path, capsys):
    assert main(["--output", str(tmp_path / "out"), "--data", str(MEASURED), "--jobs", "0"]) == 2
    assert capsys.readouterr().err == "measured: --jobs: found 0, need at least 1\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not MEASURED.is_dir(), reason="needs ../shared/data beside the repository")
def test_ctrl_c_ends_with_one_line_and_leaves_no_process(tmp_path):
    command = [
        sys.executable,
        "-c",
        "import sys; from vo2_studies.measured.command import main; sys.exit(main())",
    ]
    command += ["--output", str(tmp_path / "out"), "--data", str(MEASURED), "--no-diagnosis"]
    command += ["--only", "fast", "--only", "piezo", "--jobs", "2"]
    # a group of its own, all of which a terminal interrupts
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        deadline = time.monotonic() + 120
        while not (tmp_path / "out" / "bags" / "fast").exists() and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert error.splitlines()[-1].startswith("measured: interrupted")
    assert "Traceback" not in error
    deadline = time.monotonic() + 20  # the tracker of multiprocessing notices a little later that all is over
    while time.monotonic() < deadline:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("a process of the command still runs 20 s after its end")
