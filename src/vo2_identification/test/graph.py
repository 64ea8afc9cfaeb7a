"""A real graph of its own for a test: publishers and subscribers here, the commands as processes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from vo2_interface.one_host import free_domain, one_host_environment

PATIENCE_S = 45.0
"""How long a test waits for what normally takes a second: the machine may be busy."""
DOMAIN = free_domain(keep=True)
_SOURCES = Path(__file__).resolve().parents[2]
_PACKAGES = (
    "vo2_models",
    "vo2_interface",
    "vo2_plant_sim",
    "vo2_estimation",
    "vo2_control",
    "vo2_identification",
    "vo2_studies",
)


def environment() -> dict[str, str]:
    """Return a child's environment: this graph only, the packages of this tree, fresh library paths."""
    clean = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("_ROS_WHEELS", "RCUTILS")) and name != "LD_LIBRARY_PATH"
    }
    clean.update(one_host_environment(DOMAIN))
    clean["PYTHONUNBUFFERED"] = "1"
    clean["PYTHONPATH"] = os.pathsep.join(
        [*(str(_SOURCES / name) for name in _PACKAGES), os.environ.get("PYTHONPATH", "")]
    )
    return clean


def wait_until(condition: Callable[[], bool], what: str, *, timeout_s: float = PATIENCE_S) -> None:
    """Wait for a condition, or fail saying for what."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what} did not happen in {timeout_s} s")
        time.sleep(0.01)


class Graph:
    """A node in this process that publishes serialized messages and collects what it hears."""

    def __init__(self) -> None:
        self._before = dict(os.environ)
        os.environ.update(one_host_environment(DOMAIN))
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node(f"test_{os.getpid()}", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def publisher(self, kind: Any, topic: str, qos: Any) -> Any:
        return self.node.create_publisher(kind, topic, qos)

    def collect(self, kind: Any, topic: str, qos: Any) -> list[Any]:
        """Return a list that grows with the messages of a topic while `spin_until` runs."""
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def spin_until(self, condition: Callable[[], bool], what: str, *, timeout_s: float = PATIENCE_S) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what} did not happen in {timeout_s} s")
            self.executor.spin_once(timeout_sec=0.02)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        os.environ.clear()
        os.environ.update(self._before)


@contextmanager
def running(module: str, *arguments: object, before: Callable[[], None] | None = None):
    """Run `python -m module` for the length of the context; whatever happens, it is gone afterwards."""
    process = subprocess.Popen(
        # -B: one whose files may not grow would leave a byte code file cut short to all who come after it
        [sys.executable, "-B", "-m", module, *map(str, arguments)],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate(timeout=10)


def run(module: str, *arguments: object, timeout_s: float = PATIENCE_S) -> subprocess.CompletedProcess[str]:
    """Run `python -m module` to its end."""
    command: Sequence[str] = [sys.executable, "-m", module, *map(str, arguments)]
    return subprocess.run(
        command, env=environment(), capture_output=True, text=True, timeout=timeout_s, check=False
    )
