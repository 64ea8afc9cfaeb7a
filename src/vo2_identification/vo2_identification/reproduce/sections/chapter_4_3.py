"""4.3: compressive sensing against least squares on random Preisach densities."""

from __future__ import annotations

import numpy as np
from vo2_models.preisach.monte_carlo import METHODS, compressive_sensing_study

from vo2_identification.reproduce.claims import Claim, Context, Section, at_most
from vo2_identification.reproduce.figures import STYLES, draw

NUMBER, TITLE = "4.3", "Compressive sensing of the Preisach density"

RUNS = 20
MEASUREMENTS = tuple(range(100, 451, 50))
_PUBLISHED = {
    # error over that of least squares, per cent
    ("density", "CS Order Non-negative"): 28.1,
    ("density", "CS Order"): 34.5,
    ("density", "CS"): 73.1,
    ("model", "CS Order Non-negative"): 18.3,
    ("model", "CS Order"): 22.6,
    ("model", "CS"): 47.2,
    ("random input", "CS Order Non-negative"): 22.3,
    ("random input", "CS Order"): 24.4,
    ("random input", "CS"): 48.8,
}


def run(context: Context) -> Section:
    """Return the section's claims; about half a minute."""
    context.progress(f"{RUNS} random densities at {len(MEASUREMENTS)} numbers of measurements", 0.0)
    study = compressive_sensing_study(MEASUREMENTS, runs=RUNS, seed=context.seed)
    conditions = (
        f"{RUNS} densities per number of measurements {MEASUREMENTS}, published 1000; depends on these and on the solver of "
        "2015 (errata); CS Order uses the true order of unmeasured outputs"
    )
    claims = [
        Claim(
            f"4.3.{measure.replace(' ', '_')}.{method.lower().replace(' ', '_')}", "4.3",
            f"RMSE of {method} over that of least squares, {measure}", published,
            100 * study.ratio(measure, method), "%", at_most(published), conditions,
        )
        for (measure, method), published in _PUBLISHED.items()
    ]  # fmt: skip

    def errors(axis):
        for k, method in enumerate(METHODS):
            values = np.asarray(study.errors["model"])[:, k]
            axis.semilogy(study.measurements, values, "o" + STYLES[k % len(STYLES)], label=method)
        axis.set_xlabel("measured outputs [1]")
        axis.set_ylabel("modelling RMSE over the output range [1]")

    figure = draw("Fig. 4.4b: modelling error over the number of measurements.", errors)
    return Section(NUMBER, TITLE, tuple(claims), (figure,))
