"""4.5: what else may be sparse: densities under cosines, wavelets and differences beside the chapter's outputs under cosines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from vo2_models.device import preset, truth
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.hysteresis.preisach.signed_area import signed_area_matrix
from vo2_models.hysteresis.preisach.sparse_fit import BASES, fit_sparse
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.recording import RESISTANCE

from vo2_studies.preisach.compressive_sensing import identify_preisach_compressed
from vo2_studies.reproduce.claims import Claim, Context, Section, Table, at_least, at_most
from vo2_studies.reproduce.figures import STYLES, draw
from vo2_studies.reproduce.pool import run_many

NUMBER, TITLE = "4.5", "Compressive sensing with other sparsities, over device draws"

LEVEL = 30
MEASUREMENTS = (100, 200, 300)
DRAWS = 4
COLD, HOT = 36.0, 94.0
"""Ends of the walls [degC]."""
SETTLE_S = 0.05
SEED = 70_000
"""Of the first device, away from those of other sections."""
_OWN = {basis: f"density, {basis}" for basis in BASES}
_PLAIN = ("least squares, w >= 0", "outputs, cosine (4.2)", "outputs, cosine, w >= 0")
METHODS = (*_PLAIN, *_OWN.values(), "density, chosen")


@dataclass(frozen=True)
class Compared:
    """One device: errors (methods,) over the output range under a random input, and which basis was chosen."""

    errors: tuple[float, ...]
    chosen: str


def compare(job: tuple[int, int]) -> Compared:
    """One device and number of measurements: (seed, measurements)."""
    seed, count = job
    device, nominal = truth("integrated", seed=seed), preset("integrated")
    factor = (nominal.steady_temperature(0.008) - nominal.steady_temperature(0.0)) / 0.008**2

    def output(temperature: np.ndarray, run: int) -> np.ndarray:
        current = np.sqrt((temperature - nominal.steady_temperature(0.0)) / factor)
        return -np.log10(device.simulate(current, dt=SETTLE_S, seed=[seed, run])[RESISTANCE])

    walls = np.linspace(COLD, HOT, LEVEL + 1)
    inputs = damped_oscillation(walls)
    rng = np.random.default_rng(seed)
    probe = np.r_[COLD, random_levels(COLD, HOT, 300, seed=rng)]
    measured, answer = output(inputs, 1), output(probe, 2)
    rows = np.sort(rng.choice(inputs.size, count, replace=False))
    used = np.isin(np.arange(inputs.size), rows)
    matrix = signed_area_matrix(inputs, walls)[rows]
    w = nnls(np.hstack([matrix, -matrix[:, -1:]]), measured[rows], maxiter=100 * matrix.shape[1])[0]
    laws = [PreisachOperator(walls, w[:-2], float(w[-2] - w[-1]))]
    laws += [
        identify_preisach_compressed(measured[rows], rows, walls, nonnegative=positive)[0]
        for positive in (False, True)
    ]
    # single samples of one sweep are held out at random: blocks would leave whole loops out
    groups = rng.integers(0, 50, inputs.size)
    fits = {
        basis: fit_sparse(inputs, measured, walls, bases=(basis,), groups=groups, measured=used)
        for basis in BASES
    }
    chosen = min(fits, key=lambda basis: fits[basis].error)
    laws += [fit.operator for fit in fits.values()] + [fits[chosen].operator]
    errors = [float(np.sqrt(np.mean((law(probe) - answer) ** 2)) / np.ptp(answer)) for law in laws]
    return Compared(tuple(errors), chosen)


def run(context: Context) -> Section:
    """Return the section's claims; about two minutes of one core."""
    jobs = [(SEED + context.seed + k, count) for count in MEASUREMENTS for k in range(DRAWS)]
    found = run_many(
        compare, jobs, context.workers, lambda n: context.progress(f"fit {n} of {len(jobs)}", n / len(jobs))
    )
    errors = 100 * np.array([one.errors for one in found]).reshape(len(MEASUREMENTS), DRAWS, len(METHODS))
    mean = errors.mean(axis=1)
    rows = tuple(
        (name, *(f"{value:.2f}" for value in column)) for name, column in zip(METHODS, mean.T, strict=True)
    )
    head = ("sparse", *(f"{count} outputs" for count in MEASUREMENTS))
    caption = (
        f"Error under a random input, per cent of the output's range; unknowns {LEVEL * (LEVEL + 1) // 2 + 1}, mean of "
        f"{DRAWS} devices `integrated`, -log10 R with its noise"
    )
    basis = f"{DRAWS} devices, {', '.join(map(str, MEASUREMENTS))} of the outputs of one damped oscillation of level {LEVEL}"
    picked = [one.chosen for one in found]
    own = errors[..., -1]
    best = errors[..., len(_PLAIN) : -1].min(axis=-1)
    claims = [
        Claim(f"4.5.over_{short}", "4.5", f"Error of the density sparse in the chosen basis over that of {METHODS[k]}", None,
              float(np.mean(own / errors[..., k])), "1", at_most(1.0),
              f"mean of the ratios; lower in {int(np.sum(own < errors[..., k]))} of {own.size}; {basis}")
        for k, short in enumerate(("least_squares", "outputs", "outputs_nonnegative"))
    ]  # fmt: skip
    claims.append(
        Claim("4.5.chosen", "4.5", "Fits in which the basis chosen on held-out outputs errs least under the random input", None,
              float(np.sum(own <= best)), "1", at_least(0.75 * own.size),
              f"of {own.size}; chosen: {', '.join(f'{name} {picked.count(name)}' for name in BASES)}; {basis}")
    )  # fmt: skip

    def plot(axis):
        for k, name in enumerate(METHODS[:-1]):
            axis.semilogy(MEASUREMENTS, mean[:, k], "o" + (STYLES * 2)[k], ms=4, label=name)
        axis.set_xlabel("measured outputs [1]")
        axis.set_ylabel("error, random input [% of range]")

    story = (
        "The chapter takes the outputs of one damped oscillation as sparse after a cosine transform. Here the density itself is "
        "taken as sparse: under cosines, under Haar wavelets, or in its differences (total variation). Strength and basis are "
        "those that predict held-out ones of the measured outputs best.",
        Table(caption, head, rows),
    )
    return Section(
        NUMBER, TITLE, tuple(claims), (draw("Error over the number of outputs.", plot),), (), story
    )
