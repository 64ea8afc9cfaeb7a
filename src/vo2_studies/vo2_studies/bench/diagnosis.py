"""`./vo2 bench --only diagnosis_10k diagnosis_40k`: wall time of `diagnose` as a process, start and report included.

The recordings come from the generator of the challenge: a device with no effect, with one, with two. The figure is
the slowest of the three; minutes, so only on request.
"""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vo2_studies.bench.entry import Entry, Figure
from vo2_studies.challenge.conditions import write_recording
from vo2_studies.challenge.devices import PRESETS
from vo2_studies.challenge.draw import draw_case, follow_up_recording
from vo2_studies.challenge.excitation import TEST_SAMPLES, informative_current
from vo2_studies.challenge.plan import Choice, plan_case

__all__ = ["ENTRIES", "diagnosis", "diagnosis_seconds"]

_KINDS = ("none", "one", "two")
_SEED = 1


def _run(name: str, *options: str, folder: Path) -> float:
    """Run `python -m vo2_identification.NAME` in a folder; its wall time [s]."""
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", f"vo2_identification.{name}", *options],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{name}: exit {done.returncode}: {done.stdout.strip()[-500:]}")
    return time.monotonic() - began


def diagnosis_seconds(kind: str, lengths: Sequence[int], *, seed: int = _SEED) -> list[float]:
    """Wall times [s] of the diagnosis of one concealed device for recordings of several lengths.

    Parameters
    ----------
    kind : of the case: none, one, two or outside
    lengths : of the recordings in informative sequences of `TEST_SAMPLES` samples each
    seed : decides device, effects and noise

    Raises
    ------
    RuntimeError : `fit` or `diagnose` failed; with the end of what it printed.
    """
    plan = plan_case(seed, 0, Choice("plays", kinds=(kind,), device="integrated"))
    case = draw_case(seed, plan)
    rng = np.random.default_rng([seed, len(kind)])
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        write_recording(folder / "calibration", case.calibration.measurement, case.calibration.commands)
        calibration = ("--bag", "calibration", "--device", plan.device, "--output", "model.yaml")
        _run("fit", "--simulation-only", *calibration, folder=folder)
        times = []
        for count in lengths:
            current = np.concatenate([informative_current(rng, PRESETS[plan.device]) for _ in range(count)])
            name = f"test_{count}"
            recorded = follow_up_recording(seed, plan, case.answer, current)
            write_recording(folder / name, recorded.measurement, recorded.commands)
            options = ("--bag", name, "--model", "model.yaml", "--output", f"diagnosis_{count}")
            times.append(_run("diagnose", *options, folder=folder))
    return times


def diagnosis(sequences: int) -> Figure:
    """The slowest of the three kinds; a first diagnosis, not counted, fills the cache of compiled kernels."""
    _warm()
    seconds = {kind: diagnosis_seconds(kind, [sequences])[0] for kind in _KINDS}
    spread = ", ".join(f"{kind} {value:.1f}" for kind, value in seconds.items())
    return Figure(max(seconds.values()), "s", note=f"{sequences * TEST_SAMPLES} samples; effects: {spread}")


@functools.cache
def _warm() -> None:
    diagnosis_seconds("none", [1])


ENTRIES = (
    Entry("diagnosis_10k", functools.partial(diagnosis, 1), 20.0, on_request=True),
    Entry("diagnosis_40k", functools.partial(diagnosis, 4), 120.0, on_request=True),
)
