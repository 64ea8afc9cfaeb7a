"""7.3.1: error and time per estimate of the self-sensing schemes over their level, Fig. 7.9."""

from __future__ import annotations

import numpy as np

from vo2_studies.reproduce.claims import Claim, Context, Section, at_least, within_or_below
from vo2_studies.reproduce.figures import STYLES, draw
from vo2_studies.reproduce.pool import run_many
from vo2_studies.self_sensing.level_study import LEVELS, SCHEMES, level_errors

NUMBER, TITLE = "7.3.1", "Self-sensing schemes over their level"

DEVICES = 3
_PUBLISHED = {
    # level, mean error [um], time per estimate [us]
    "composite": (6, 0.95, 160.0),
    "preisach": (10, 1.19, 680.0),
    "egpi": (6, 1.26, 110.0),
    "polynomial": (8, 2.66, 4.0),
}


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
        *(
            Claim(f"7.3.1.{kind}", "7.3.1", f"Mean error of the {kind} scheme of level {level}", published,
                  float(error[LEVELS.index(level), SCHEMES.index(kind)]), "um", within_or_below(published, 0.1),
                  f"{basis}; published: on the identification record")
            for kind, (level, published, _) in _PUBLISHED.items()
        ),
        *(
            Claim(f"7.3.1.{kind}_time", "7.3.1", f"Time per estimate of the {kind} scheme of level {level}", published,
                  float(duration[LEVELS.index(level), SCHEMES.index(kind)]), "us", within_or_below(published, 0.1),
                  "one sample at a time from Python; published: Matlab")
            for kind, (level, _, published) in _PUBLISHED.items()
        ),
        *(
            Claim(f"7.3.1.composite_over_{kind}", "7.3.1", f"Mean error: composite over {kind}",
                  _PUBLISHED["composite"][1] / _PUBLISHED[kind][1],
                  float(error[0, composite] / error[LEVELS.index(_PUBLISHED[kind][0]), SCHEMES.index(kind)]), "1",
                  within_or_below(_PUBLISHED["composite"][1] / _PUBLISHED[kind][1], 0.1), basis)
            for kind in ("preisach", "egpi", "polynomial")
        ),
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
