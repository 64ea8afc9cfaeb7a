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
