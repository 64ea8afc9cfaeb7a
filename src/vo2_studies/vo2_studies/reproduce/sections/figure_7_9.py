"""7.3.1: error and time per estimate of the self-sensing schemes over their level, Fig. 7.9."""

from __future__ import annotations

import numpy as np

from vo2_studies.reproduce.claims import Claim, Context, Section, at_least, at_most
from vo2_studies.reproduce.figures import STYLES, draw
from vo2_studies.reproduce.pool import run_many
from vo2_studies.self_sensing.level_study import LEVELS, SCHEMES, level_errors

NUMBER, TITLE = "7.3.1", "Self-sensing schemes over their level"

DEVICES = 3


def _job(job: tuple[int, int]) -> dict[str, tuple[float, float]]:
    seed, level = job
    return level_errors(seed, level)


def run(context: Context) -> Section:
    """Return the section's claims; about 4 s per level, device and core."""
    jobs = [(context.seed + k, level) for level in LEVELS for k in range(DEVICES)]
    found = run_many(
        _job, jobs, context.workers, lambda n: context.progress(f"{n} of {len(jobs)} fits", n / len(jobs))
    )
    table = np.array([[row[kind] for kind in SCHEMES] for row in found])
    error, duration = np.moveaxis(
        table.reshape(len(LEVELS), DEVICES, len(SCHEMES), 2).mean(axis=1) * 1e6, -1, 0
    )
    composite = SCHEMES.index("composite")
    basis = (
        f"mean over {DEVICES} device seeds identified from a noisy damped oscillation of 30 levels; 200 random levels; "
        "level means plays, cells a side, or degree"
    )
    claims = (
        Claim("7.3.1.composite_lowest", "7.3.1", "Levels of 6 to 10 at which the composite scheme has the lowest error",
              5.0, float(np.sum(np.argmin(error, axis=1) == composite)), "1", at_least(5.0), basis),
        Claim("7.3.1.composite_6", "7.3.1", "Mean error of the composite scheme of level 6", 0.95,
              float(error[0, composite]), "um", at_most(0.95), f"{basis}; published: on the identification record"),
        Claim("7.3.1.composite_time", "7.3.1", "Time per estimate of the composite scheme, largest of the levels", 160.0,
              float(duration[:, composite].max()), "us", at_most(20.0), "one sample at a time from Python; published: Matlab"),
    )  # fmt: skip

    def plot(above, below):
        for k, (kind, style) in enumerate(zip(SCHEMES, STYLES, strict=True)):
            above.plot(LEVELS, error[:, k], style, marker="o", label=kind)
            below.plot(LEVELS, duration[:, k], style, marker="o", label=kind)
        above.set_ylabel("mean error [um]")
        below.set_ylabel("time per estimate [us]")
        below.set_yscale("log")
        below.set_xlabel("level")

    figure = draw("Fig. 7.9: error and time per estimate over the level.", plot, rows=2, height=2.5)
    return Section(NUMBER, TITLE, claims, (figure,))
