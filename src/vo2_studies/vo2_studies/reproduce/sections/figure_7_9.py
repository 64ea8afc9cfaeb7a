"""7.3.1: error and time per estimate of the self-sensing schemes over their level, Fig. 7.9."""

from __future__ import annotations

import numpy as np

from vo2_studies.reproduce.claims import Claim, Context, Section, at_least, baseline, within_or_below
from vo2_studies.reproduce.figures import STYLES, draw
from vo2_studies.reproduce.pool import run_many
from vo2_studies.self_sensing.level_study import LEVELS, SCHEMES, SchemeErrors, level_errors

NUMBER, TITLE = "7.3.1", "Self-sensing schemes over their level"

DEVICES = 3
_PUBLISHED = {
    # level; mean and largest error on the identification record [um]; time per estimate [us]
    "composite": (6, 0.95, 4.01, 160.0),
    "preisach": (10, 1.19, 6.68, 680.0),
    "egpi": (6, 1.26, 4.65, 110.0),
    "polynomial": (8, 2.66, 6.48, 4.0),
}
_WORDS = ("Mean error", "Largest error", "Time per estimate")
_NAMES = ("", "_largest", "_time")


def _job(job: tuple[int, int]) -> dict[str, SchemeErrors]:
    seed, level = job
    return level_errors(seed, level)


def run(context: Context) -> Section:
    """Return the section's claims; about 4 s per level, device and core."""
    jobs = [(context.seed + k, level) for level in LEVELS for k in range(DEVICES)]
    found = run_many(
        _job, jobs, context.workers, lambda n: context.progress(f"{n} of {len(jobs)} fits", n / len(jobs))
    )
    table = 1e6 * np.array([
        [(row[kind].mean_m, row[kind].largest_m, row[kind].time_s) for kind in SCHEMES] for row in found
    ])  # fmt: skip
    # figure, level, scheme
    ours = np.moveaxis(table.reshape(len(LEVELS), DEVICES, len(SCHEMES), 3).mean(axis=1), -1, 0)
    basis = (
        f"on the recording it was identified from, as published, of the true deflection; mean over {DEVICES} device seeds, a "
        "noisy damped oscillation of 30 levels; level means plays, cells a side, or degree"
    )
    timing = "one sample at a time from Python, processor of this machine; published: Matlab"

    def of(kind: str, column: int) -> float:
        return float(ours[column, LEVELS.index(_PUBLISHED[kind][0]), SCHEMES.index(kind)])

    claims = [
        Claim("7.3.1.composite_lowest", "7.3.1", "Levels of 6 to 10 at which the composite scheme has the lowest error",
              5.0, float(np.sum(np.argmin(ours[0], axis=1) == SCHEMES.index("composite"))), "1", at_least(5.0), basis),
    ]  # fmt: skip
    for column, (words, name) in enumerate(zip(_WORDS, _NAMES, strict=True)):
        unit, conditions = ("us", timing) if name == "_time" else ("um", basis)
        for kind, (level, *published) in _PUBLISHED.items():
            theirs = published[column]
            proposed = kind == "composite" or name == "_time"
            claims.append(
                Claim(f"7.3.1.{kind}{name}", "7.3.1", f"{words} of the {kind} scheme of level {level}", theirs,
                      of(kind, column), unit, within_or_below(theirs, 0.1) if proposed else baseline(theirs), conditions)
            )  # fmt: skip
            if kind != "composite":
                ratio = _PUBLISHED["composite"][1 + column] / theirs
                claims.append(
                    Claim(f"7.3.1.composite_over_{kind}{name}", "7.3.1", f"{words}: composite over {kind}", ratio,
                          of("composite", column) / of(kind, column), "1", within_or_below(ratio, 0.1), conditions)
                )  # fmt: skip

    def plot(above, below):
        for k, (kind, style) in enumerate(zip(SCHEMES, STYLES, strict=True)):
            above.plot(LEVELS, ours[0, :, k], style, marker="o", label=kind)
            below.plot(LEVELS, ours[2, :, k], style, marker="o", label=kind)
        above.set_ylabel("mean error [um]")
        below.set_ylabel("time per estimate [us]")
        below.set_yscale("log")
        below.set_xlabel("level")

    figure = draw("Fig. 7.9: error and time per estimate over the level.", plot, rows=2, height=2.5)
    return Section(NUMBER, TITLE, tuple(claims), (figure,))
