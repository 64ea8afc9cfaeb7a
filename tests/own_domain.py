"""Processes on a ROS domain of their own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

from vo2_interface.one_host import free_domain
from vo2_studies.demo.graph import Graph

__all__ = ["processes"]


@contextmanager
def processes(logs: Path) -> Iterator[Graph]:
    """Give a graph without processes; those that it starts are ended, whatever happens.

    Yields
    ------
    Graph : this process has its environment as long as the context lasts
    """
    found = Graph(free_domain(), logs)
    with patch.dict(os.environ, found.environment()):
        try:
            yield found
        finally:
            found.end()
