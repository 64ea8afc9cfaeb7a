"""Leaving the graph: what hangs there is ended, and says where it hung."""

from __future__ import annotations

import subprocess
import sys

STUCK = """
import ctypes
from vo2_plant_sim.interface import executable

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
