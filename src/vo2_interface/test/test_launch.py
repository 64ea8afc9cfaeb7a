"""Launch arguments of the pages beside a loop; tests/test_launch_files.py looks at all launch files."""

import ast
from pathlib import Path

import pytest

LAUNCH_FILES = sorted(Path(__file__).resolve().parents[2].glob("*/launch/*.launch.py"))


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_one_argument_lets_every_node_follow_simulated_time(path):
    calls = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]
    used = {
        name: [getattr(call.args[0], "value", "") for call in calls if getattr(call.func, "id", "") == name]
        for name in ("DeclareLaunchArgument", "LaunchConfiguration")
    }
    assert "use_sim_time" in used["DeclareLaunchArgument"]
    assert "use_sim_time" in used["LaunchConfiguration"]
