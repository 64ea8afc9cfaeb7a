"""System tests: real processes on a real graph, each test on a ROS domain of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from own_domain import processes
from vo2_interface.testing import hear_ctrl_c
from vo2_models.device import truth
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.model_file import save_model_parameters
from vo2_models.workflow import fit
from vo2_studies.demo.conductor import Conductor

hear_ctrl_c()


@pytest.fixture
def graph(tmp_path):
    """Processes of this test."""
    with processes(tmp_path / "logs") as found:
        yield found


@pytest.fixture
def conductor(graph):
    """A node that talks to the processes of this test."""
    found = Conductor(graph)
    yield found
    found.close()


@pytest.fixture(scope="session")
def model_file(tmp_path_factory) -> Path:
    """A model of device 1, identified from a simulated recording."""
    share = damped_oscillation(np.linspace(0.0, 1.0, 21))
    recording = truth("integrated", seed=1).simulate(np.repeat(3.68e-3 + 4.81e-3 * share, 10), seed=1)
    path = tmp_path_factory.mktemp("model") / "model.yaml"
    save_model_parameters(path, fit(recording, "integrated"))
    return path
