"""What a node says in the log names the place that says it."""

import inspect

from vo2_interface.diagnostics import Diagnostics
from vo2_interface.testing import bench


def test_a_log_line_names_the_file_and_the_line_that_report(capfd, monkeypatch):
    monkeypatch.setenv("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{file_name}:{line_number}: {severity}: {message}")
    with bench() as rig:
        diagnostics = Diagnostics(rig.node)
        # one place in the code, every severity: rclpy refuses a place that changes its own
        for level in ("ok", "warn", "error", "ok"):
            line = inspect.currentframe().f_lineno + 1
            diagnostics.report("model", level, f"as {level}")
        diagnostics.count("model", "too many")
    said = capfd.readouterr().err
    for level, severity in (("ok", "INFO"), ("warn", "WARN"), ("error", "ERROR")):
        assert f"{__file__}:{line}: {severity}: model: as {level}" in said
    assert "model: too many" in said
    assert "rcutils_logger.py" not in said
