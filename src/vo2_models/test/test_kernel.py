"""The cache of compiled kernels: used where nothing changed, never where anything did that is in the code."""

import os
import subprocess
import sys

import pytest

CALL = "from vo2_elsewhere.one import scaled; print(scaled(2.0), sum(scaled.stats.cache_hits.values()))"


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "vo2_elsewhere"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "constants.py").write_text("FACTOR = 3.0\n")
    (folder / "inner.py").write_text(
        "from vo2_models.numerics.kernel import kernel\n"
        "from vo2_elsewhere.constants import (\n    FACTOR,\n)\n\n"
        "@kernel\ndef inner(x):\n    return FACTOR * x\n"
    )
    (folder / "one.py").write_text(
        "from vo2_elsewhere import inner\n"
        "from vo2_models.numerics.kernel import kernel\n"
        "there = inner.inner\n\n"
        "@kernel\ndef scaled(x):\n    return there(x) + 1.0\n"
    )
    return folder


def answer(package):
    """Value and number of loads from the cache, in a new process."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(package.parent), *sys.path]),
        "VO2_KERNEL_CACHE": str(package.parent / "cache"),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    shown = subprocess.run(
        [sys.executable, "-c", CALL], env=environment, capture_output=True, text=True, check=True
    )
    value, hits = shown.stdout.split()
    return float(value), int(hits)


def test_a_kernel_is_loaded_again_and_compiled_anew_after_a_change_in_any_file_it_takes_from(package):
    assert answer(package) == (7.0, 0)
    assert answer(package) == (7.0, 1)
    (package / "constants.py").write_text(
        "FACTOR = 5.0\n"
    )  # as long as before: neither size nor bytecode tells
    assert answer(package) == (11.0, 0)
    (package / "inner.py").write_text((package / "inner.py").read_text().replace("FACTOR * x", "FACTOR - x"))
    assert answer(package) == (4.0, 0)
    assert answer(package) == (4.0, 1)


def test_a_ctrl_c_that_a_callback_drops_comes_again():
    """In a callback of C, as LLVM's are, Python drops what is raised; twice here."""
    program = (
        "import ctypes, os, signal, sys, time\n"
        "import vo2_models.numerics.kernel\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "@ctypes.CFUNCTYPE(None)\n"
        "def callback():\n"
        "    print('within', flush=True)\n"
        "    time.sleep(10)\n"
        "try:\n"
        "    signal.setitimer(signal.ITIMER_REAL, 0.05)\n"
        "    signal.signal(signal.SIGALRM, signal.default_int_handler)\n"
        "    callback()\n"
        "    callback()\n"
        "    time.sleep(20)\n"
        "except KeyboardInterrupt:\n"
        "    sys.exit(130)\n"
    )
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert shown.returncode == 130 and shown.stderr == ""
    assert shown.stdout == "within\nwithin\n"


def test_other_errors_of_callbacks_are_shown_as_before():
    program = "import ctypes\nimport vo2_models.numerics.kernel\nctypes.CFUNCTYPE(None)(lambda: 1 / 0)()\n"
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert shown.returncode == 0 and "ZeroDivisionError" in shown.stderr
