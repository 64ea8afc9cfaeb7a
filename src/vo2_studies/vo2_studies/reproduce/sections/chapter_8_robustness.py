"""Beyond 8.4: one fixed design on devices of other time constant, noise and hysteresis."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np
from vo2_control.controller import LinearController
from vo2_models.device import truth
from vo2_models.device.coefficients import Coefficient, Sensor, sensor_index
from vo2_models.recording import RESISTANCE
from vo2_models.self_sensing import self_sensing

from vo2_studies.reproduce.claims import Claim, Context, Section, at_most
from vo2_studies.reproduce.figures import draw
from vo2_studies.reproduce.identified import identify
from vo2_studies.reproduce.own_designs import (
    TIME_CONSTANT_SPREAD,
    Designs,
    feedforward,
    own_designs,
)
from vo2_studies.reproduce.peltier import LIMITS, experiment, merit
from vo2_studies.reproduce.pool import run_many

NUMBER, TITLE = "8.6", "Robustness of the own design over device draws"

FIRST_SEED = 10_000
"""Added to the context's seed: devices that neither the designs nor section 8.5 have."""
NOISE_FACTORS = (0.5, 2.0)
LOST_M = 25e-6
"""An error of the last quarter above this counts as instability: a third of the range, far above any cycle."""


@dataclass(frozen=True)
class Survival:
    """One device: factors drawn, RMSE and largest error [um], largest error of the last quarter [m], is all finite."""

    factor: float
    noise: float
    rmse_um: float
    largest_um: float
    late_m: float
    finite: bool


def survive(job: tuple[Designs, int]) -> Survival:
    """Identify a device, then let its time constant and noise be others; the law is that of the design devices."""
    designs, seed = job
    device = truth("peltier", seed=seed)
    _, parameters = identify(device, seed)
    rng = np.random.default_rng([seed, 86])
    factor = 1 + TIME_CONSTANT_SPREAD * rng.uniform(-1, 1)
    noise = float(np.exp(rng.uniform(*np.log(NOISE_FACTORS))))
    coefficients = device.coefficients.copy()
    coefficients[Coefficient.TIME_CONSTANT] *= factor
    for place in (Sensor.NOISE, Sensor.NOISE_RELATIVE):
        coefficients[sensor_index(RESISTANCE, place)] *= noise
    changed = replace(device, coefficients=coefficients)
    plan = feedforward(parameters, "noise", designs.rate_k_per_s)
    result = experiment(
        "noise", changed, self_sensing("composite", parameters), LinearController(designs.robust, LIMITS), seed,
        feedforward_a=plan.current_a, expected_m=plan.expected_m,
    )  # fmt: skip
    found = merit("noise", result)
    late = np.abs(result.error_m[-result.time_s.size // 4 :])
    return Survival(
        factor,
        noise,
        found.rmse_um,
        found.largest_um,
        float(late.max()),
        bool(np.isfinite(result.error_m).all()),
    )


def run(context: Context) -> Section:
    """Return the section's claims; a minute for the designs, then about 1.5 s per draw and core."""
    designs = own_designs(context.workers, context.progress)
    jobs = [(designs, FIRST_SEED + context.seed + k) for k in range(context.robust_draws)]
    found = run_many(
        survive, jobs, context.workers,
        lambda n: context.progress(f"device {n} of {len(jobs)}", 0.1 + 0.9 * n / len(jobs)),
        context.finished(NUMBER, astuple, lambda row: Survival(*row)),
    )  # fmt: skip
    rmse, largest, late = (
        np.array([getattr(s, n) for s in found]) for n in ("rmse_um", "largest_um", "late_m")
    )
    factor = np.array([s.factor for s in found])
    lost = ~np.array([s.finite for s in found]) | ~(late <= LOST_M)
    conditions = (
        f"{context.robust_draws} draws, each with the device spread of hysteresis, resistance and thermal body; after "
        f"identification its time constant changes by up to +-{100 * TIME_CONSTANT_SPREAD:.0f} % and its resistance noise by "
        f"{NOISE_FACTORS[0]:g} to {NOISE_FACTORS[1]:g} times; multi-sine with current noise; one law for all"
    )
    claims = (
        Claim("8.6.instabilities", "8.6", "Unstable loops", None, float(lost.sum()), "1", at_most(0.0),
              f"unstable: an error above {1e6 * LOST_M:.0f} um in the last quarter, or one that is not finite; {conditions}"),
        Claim("8.6.late", "8.6", "Largest error of the last quarter over all draws", None, float(1e6 * late.max()), "um",
              at_most(1e6 * LOST_M), conditions),
        Claim("8.6.rmse", "8.6", "RMSE, 99th over 50th percentile of the draws", None,
              float(np.percentile(rmse, 99) / np.median(rmse)), "1", at_most(2.0),
              f"median {np.median(rmse):.2f} um, 99th percentile {np.percentile(rmse, 99):.2f}, largest {rmse.max():.2f}; "
              f"{conditions}"),
    )  # fmt: skip

    def histograms(left, right):
        left.hist(rmse, bins=40, color="#0072B2")
        left.set_xlabel("RMSE [um]")
        left.set_ylabel("devices [1]")
        right.hist(largest, bins=40, color="#D55E00")
        right.set_xlabel("largest error [um]")

    def over_factor(axis):
        axis.plot(factor, rmse, ".", ms=3)
        axis.set_xlabel("time constant over the identified one [1]")
        axis.set_ylabel("RMSE [um]")

    figures = (
        draw(
            f"Errors of {context.robust_draws} devices, multi-sine with current noise.", histograms, columns=2
        ),
        draw("The same over the change of the time constant.", over_factor),
    )
    return Section(NUMBER, TITLE, claims, figures)
