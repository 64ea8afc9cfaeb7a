"""How long a new process waits: for the package, and for the first compiled call once the cache is there."""

from __future__ import annotations

import statistics
import subprocess
import sys
from time import perf_counter

from vo2_studies.bench.entry import Entry, Figure

__all__ = ["ENTRIES"]

_FIRST_CALL = """
from vo2_models.hysteresis import GPI, RobustInverse, TanhEnvelopes
model = GPI([0.0, 0.5], [1.0, 1.0], TanhEnvelopes(1.0, -0.4, 1.0, 0.4), input_range=(-2, 2))
output, state = model.simulate([0.0, 1.0, 0.0])
model.update(0.5, state)
RobustInverse(model).update(0.1, state)
"""


def _seconds(code: str, repeats: int) -> float:
    """Median wall-clock seconds of new processes that run `code`; one unmeasured before fills the caches."""
    seconds = []
    for k in range(repeats + 1):
        start = perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
        if k:
            seconds.append(perf_counter() - start)
    return statistics.median(seconds)


def import_package() -> Figure:
    """`import vo2_models` in a new process, less the start of Python itself."""
    return Figure(
        max(_seconds("import vo2_models", 7) - _seconds("pass", 7), 0.0), "s", note="above bare Python"
    )


def first_call() -> Figure:
    """A second process from its start to a simulated, a streamed and an inverted sample."""
    return Figure(_seconds(_FIRST_CALL, 3), "s", note="whole process, compiled code from the disk cache")


ENTRIES = (
    Entry("import", import_package, 0.5),
    Entry("first_call", first_call, 2.0),
)
