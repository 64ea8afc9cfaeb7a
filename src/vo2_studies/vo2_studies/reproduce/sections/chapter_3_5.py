"""3.5: entropy-optimal compression of GPI models in simulation: partitions, errors, cost, against output optimisation."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls
from vo2_models.hysteresis import GPI, TanhEnvelopes, compress, merge, partition
from vo2_models.hysteresis.compression_gpi import group_loss, scaling
from vo2_models.identification.excitation import random_levels

from vo2_studies.reproduce.claims import Claim, Context, Section, at_most, baseline, within, within_or_below
from vo2_studies.reproduce.figures import STYLES, draw

NUMBER, TITLE = "3.5", "Entropy-based compression of the GPI model"

Floats = NDArray[np.float64]

PLAYS, GROUPS = 30, 6
SPAN = (-1.0, 1.0)
ENVELOPES = TanhEnvelopes(4.5, -0.8, 4.0, 0.6)
"""Ours: the values of Table 3.1 are lost. They span 2 to within 0.4 %, so that all 30 radii have a play that moves."""
RANDOM_DRAWS = 6
RANDOM_INPUTS = 50
UNIFORM = (0, 5, 10, 15, 20, 25, 30)

_CUTS = {
    # Tables 3.2 to 3.4
    ("3.5.1", "uniform", "sum"): UNIFORM,
    ("3.5.1", "uniform", "max"): UNIFORM,
    ("3.5.2", "one_peak", "sum"): (0, 11, 13, 14, 16, 18, 30),
    ("3.5.2", "one_peak", "max"): (0, 9, 12, 14, 16, 18, 30),
    ("3.5.3", "two_peaks", "sum"): (0, 7, 8, 14, 22, 23, 30),
    ("3.5.3", "two_peaks", "max"): (0, 6, 8, 11, 21, 23, 30),
}
_ERRORS = {
    # the same tables and 3.5: uniform compression, Entropy Sum, Entropy Max, per cent of the output range
    ("3.5.1", "uniform"): (0.75, 0.75, 0.75),
    ("3.5.2", "one_peak"): (0.34, 0.08, 0.14),
    ("3.5.3", "two_peaks"): (0.42, 0.27, 0.20),
    ("3.5.4", "random"): (0.53, 0.54, 0.53),
}
_TWO_PEAKS = (
    "(3.16) with the 8 that is printed in its exponents gives another partition; with 4 the printed one is the best of all "
    "(see the claim of our own): the partitions of Table 3.4 were computed with other weights than the text prints"
)
_RANDOM_CUTS = {"sum": (0, 5, 9, 13, 18, 24, 30), "max": (0, 6, 10, 15, 20, 25, 30)}
"""Table 3.5; its weights were drawn at random and are not printed."""
_TRAINING = (0.165, 0.088)
"""Section 3.5.6: RMSE of Entropy Sum and of output optimisation on the training input."""


def scaled_weights(case: str, rng: np.random.Generator) -> Floats:
    """p' of the four cases, (3.14) to (3.16); the published random draw is not given.

    "two_peaks_narrow" is (3.16) with 4 in place of 8 in its exponents.
    """
    j = np.arange(1, PLAYS + 1)
    if case == "uniform":
        return np.full(PLAYS, 0.5)
    if case == "one_peak":
        return np.asarray(5 / np.sqrt(2 * np.pi) * np.exp(-((j - 15) ** 2) / 15))
    if case.startswith("two_peaks"):
        width = 4 if case == "two_peaks_narrow" else 8
        return np.asarray(5 / np.sqrt(2 * np.pi) * np.exp(-((j - np.where(j <= 16, 8, 23)) ** 2) / width))
    return rng.uniform(0.0, 1.0, PLAYS)


def original(weights: Floats) -> GPI:
    """The model of 30 plays, r_j = j / 31, with these scaled weights."""
    radii = np.arange(1, PLAYS + 1) / (PLAYS + 1)
    reach = scaling(GPI(radii, np.ones(PLAYS), ENVELOPES), radii, SPAN)
    return GPI(radii, weights / reach, ENVELOPES, 0.0, SPAN)


def output(model: GPI, v: Floats) -> Floats:
    return np.asarray(model.simulate(v, model.initial_state("lower", v=SPAN[0]))[0])


def rmse(model: GPI, v: Floats, wanted: Floats) -> float:
    return float(np.sqrt(np.mean((output(model, v) - wanted) ** 2)))


def damped_sine() -> Floats:
    """Full range, falling amplitude."""
    return np.asarray(-np.cos(np.linspace(0, 40, 3000)) * np.linspace(1, 0.05, 3000))


def third_order_reversal() -> Floats:
    """Up, and three reversals inside: the training input of Fig. 3.10(a), its levels ours."""
    turns = (-1.0, 1.0, -0.6, 0.6, -0.2)
    return np.concatenate([np.linspace(a, b, 150) for a, b in itertools.pairwise(turns)])


def ramps(levels: Floats, samples: int = 20) -> Floats:
    return np.concatenate([np.linspace(a, b, samples) for a, b in itertools.pairwise(levels)])


def output_optimised(model: GPI, v: Floats, start: GPI, rng: np.random.Generator) -> GPI:
    """Six plays of least output error on `v`: radii by nonlinear least squares, weights and bias solved for each."""
    wanted = output(model, v)

    def solve(radii: Floats) -> tuple[GPI, Floats]:
        ordered = np.sort(radii)
        plays = [output(GPI([r], [1.0], ENVELOPES, 0.0, SPAN), v) for r in ordered]
        matrix = np.column_stack([*plays, np.ones(v.size), -np.ones(v.size)])
        w = nnls(matrix, wanted)[0]
        return GPI(ordered, w[:GROUPS], ENVELOPES, float(w[-2] - w[-1]), SPAN), matrix @ w - wanted

    starts = [start.radii, *(np.sort(rng.uniform(0.02, 0.98, GROUPS)) for _ in range(3))]
    runs = [
        least_squares(lambda r: solve(r)[1], r, bounds=(0.0, 1.0), diff_step=1e-3, max_nfev=25)
        for r in starts
    ]
    return solve(min(runs, key=lambda run: run.cost).x)[0]


def run(context: Context) -> Section:
    """Return the section's claims; about 15 s."""
    rng = np.random.default_rng(context.seed)
    radii = np.arange(1, PLAYS + 1) / (PLAYS + 1)
    claims = []
    for (section, case, criterion), published in _CUTS.items():
        cuts = partition(
            radii, scaled_weights(case, rng), GROUPS, criterion="sum" if criterion == "sum" else "max"
        ).cuts
        claims.append(
            Claim(
                f"{section}.{case}_{criterion}", section,
                f"Cut indices of Entropy {criterion.capitalize()}, {case.replace('_', '-')} case, that differ from the table",
                0.0, float(np.sum(cuts != np.array(published))), "1", at_most(0.0),
                f"published {published}, ours {tuple(int(c) for c in cuts)}",
                _TWO_PEAKS if case == "two_peaks" else "",
            )
        )  # fmt: skip
        if case == "two_peaks":
            claims.append(
                Claim(f"{section}.{case}_{criterion}_narrow", section,
                      f"Loss of the printed partition over the least, Entropy {criterion.capitalize()}, 4 in the exponents of "
                      "(3.16)", None, _over_least(radii, scaled_weights("two_peaks_narrow", rng), published, criterion), "1",
                      within(1.0, 1e-3), f"published {published}; two partitions may differ where there is next to no weight")
            )  # fmt: skip
    context.progress("errors of the compressed models", 0.05)
    claims += _error_claims(rng)
    context.progress("dynamic programme and exhaustive search", 0.15)
    groups, fast, slow, worst = _against_exhaustive(radii, scaled_weights("one_peak", rng))
    claims.append(
        Claim("3.5.5.optimal", "3.5.5", "Loss of the dynamic programme over that of the best of all partitions", None, worst,
              "1", within(1.0, 1e-9), f"Entropy Sum, one-peak case, N = {PLAYS}, largest of M = {groups[0]} to {groups[-1]}")
    )  # fmt: skip
    claims.append(
        Claim("3.5.5.time", "3.5.5", f"Time of the dynamic programme over that of exhaustive search, M = {groups[-1]}", None,
              fast[-1] / slow[-1], "1", at_most(0.01), "compiled against plain Python with all group losses tabulated")
    )  # fmt: skip
    training, testing, shown = _against_output_optimisation(rng, context.progress)
    basis = (
        f"mean over {RANDOM_DRAWS} random weight distributions, reversal levels ours; ours optimises six radii, weights and "
        "bias from four starts"
    )
    claims += [
        Claim("3.5.6.training", "3.5.6", "Training input: RMSE of output optimisation over that of Entropy Sum",
              _TRAINING[1] / _TRAINING[0], float(np.mean(training[:, 1] / training[:, 0])), "1",
              within(_TRAINING[1] / _TRAINING[0], 0.1), basis),
        Claim("3.5.6.training_sum", "3.5.6", "Training input: RMSE of Entropy Sum", _TRAINING[0], float(training[:, 0].mean()),
              "output unit", within(_TRAINING[0], 0.2), basis),
        Claim("3.5.6.training_output", "3.5.6", "Training input: RMSE of output optimisation", _TRAINING[1],
              float(training[:, 1].mean()), "output unit", within(_TRAINING[1], 0.2), basis),
        Claim("3.5.6.random", "3.5.6", f"{RANDOM_INPUTS} random inputs: mean RMSE, Entropy Sum over output optimisation",
              1.0, float(np.mean(testing[:, :, 0].mean(1) / testing[:, :, 1].mean(1))), "1", at_most(1.0),
              f"published in words, 'more robust': below 1; {basis}"),
        Claim("3.5.6.random_worst", "3.5.6", f"{RANDOM_INPUTS} random inputs: largest RMSE, Entropy Sum over output optimisation",
              None, float(np.mean(testing[:, :, 0].max(1) / testing[:, :, 1].max(1))), "1", at_most(1.0), basis),
    ]  # fmt: skip

    def weights(*axes):
        for axis, (_, case) in zip(axes, _ERRORS, strict=True):
            p = scaled_weights(case, np.random.default_rng(context.seed))
            axis.bar(radii, p, width=0.02, color="#56B4E9")
            cuts = partition(radii, p, GROUPS).cuts
            for cut in cuts[1:-1]:
                axis.axvline((cut + 0.5) / (PLAYS + 1), color="#D55E00", ls="--", lw=1)
            axis.set_title(f"{case.replace('_', ' ')}: weights and cuts of Entropy Sum", fontsize=8)
            axis.set_xlabel("radius [1]")
            axis.set_ylabel("scaled weight [1]")

    def effort(axis):
        axis.semilogy(groups, 1e3 * np.array(slow), "s--", label="exhaustive search")
        axis.semilogy(groups, 1e3 * np.array(fast), "o-", label="dynamic programme")
        axis.set_xticks(groups)
        axis.set_xlabel("groups M [1]")
        axis.set_ylabel("time [ms]")

    def robustness(top, bottom):
        for k, (name, trace) in enumerate(shown.items()):
            top.plot(trace, STYLES[k], label=name)
        top.set_xlabel("sample of the training input [1]")
        top.set_ylabel("error [output unit]")
        top.legend(loc="lower left", fontsize=8)
        for k, name in enumerate(shown):
            bottom.plot(np.arange(1, RANDOM_INPUTS + 1), testing[0, :, k], "o" + STYLES[k], ms=3, label=name)
        bottom.set_xlabel("random input [1]")
        bottom.set_ylabel("RMSE [output unit]")

    figures = (
        draw("Fig. 3.3 to 3.7: the four distributions of scaled weights.", weights, rows=2, columns=2, height=2.3),
        draw("Fig. 3.8: time of the optimisation.", effort, height=2.6),
        draw("Fig. 3.10c and 3.11c: six plays by Entropy Sum and by output optimisation, first draw.", robustness,
             rows=2, height=2.4),
    )  # fmt: skip
    remarks = (
        "The partitions of Table 3.4 (two peaks) are not those of least loss for (3.16) under the reading of section 3.3 that "
        "gives Tables 3.2 and 3.3 exactly. With 4 in place of 8 in its exponents they are, so other weights were computed than "
        "are printed. The errors of that table do not say so by themselves: those of uniform compression and of Entropy Sum "
        "agree with (3.16) as printed, that of Entropy Max does not, and the envelopes they depend on are lost.",
        "Compression with scaled weights also shifts the bias, which the dissertation does not have (see "
        f"compression_gpi.merge): here by at most {100 * _bias_shift(np.random.default_rng(context.seed)):.2f} % of the output "
        "range.",
        "Entropy Sum sees no input, output optimisation only its training input. "
        "Which of the two predicts other inputs better is what the lines of 3.5.6 say.",
    )
    return Section(NUMBER, TITLE, tuple(claims), figures, remarks)


def _over_least(radii: Floats, weights: Floats, cuts: tuple[int, ...], criterion: str) -> float:
    """Loss of a partition over that of the best one with as many groups."""
    losses = [group_loss(radii[a:b], weights[a:b]) for a, b in itertools.pairwise(cuts)]
    total = sum(losses) if criterion == "sum" else max(losses)
    return float(
        total / partition(radii, weights, GROUPS, criterion="sum" if criterion == "sum" else "max").loss
    )


def _error_claims(rng: np.random.Generator) -> list[Claim]:
    v = damped_sine()
    claims = []
    for (section, case), published in _ERRORS.items():
        rows, cuts = [], []
        for _ in range(RANDOM_DRAWS if case == "random" else 1):
            model = original(scaled_weights(case, rng))
            wanted = output(model, v)
            best = [compress(model, GROUPS, criterion=criterion) for criterion in ("sum", "max")]
            reduced = [merge(model, UNIFORM), *(found.model for found in best)]
            rows.append([100 * rmse(m, v, wanted) / np.ptp(wanted) for m in reduced])
            cuts.append([found.cuts for found in best])
        ours = np.mean(rows, axis=0)
        for name, theirs, value in zip(("uniform", "sum", "max"), published, ours, strict=True):
            scheme = "uniform compression" if name == "uniform" else f"Entropy {name.capitalize()}"
            claims.append(
                Claim(f"{section}.{case}_{name}_error", section, f"Modelling error of {scheme}, {case.replace('_', '-')} case",
                      theirs, float(value), "%", baseline(theirs) if name == "uniform" else within_or_below(theirs, 0.1),
                      "RMSE over output range under a damped sine; envelopes and input ours (Table 3.1 is lost)"
                      + (f"; mean over {RANDOM_DRAWS} draws" if case == "random" else "")
                      + (_of_printed(name, v, rng) if case == "two_peaks" and name != "uniform" else ""))
            )  # fmt: skip
        if case in ("one_peak", "two_peaks"):
            for k, name in ((1, "sum"), (2, "max")):
                claims.append(
                    Claim(f"{section}.{case}_{name}_ratio", section,
                          f"Error of Entropy {name.capitalize()} over that of uniform compression, {case.replace('_', '-')} case",
                          published[k] / published[0], float(ours[k] / ours[0]), "1",
                          within_or_below(published[k] / published[0], 0.1), "as above")
                )  # fmt: skip
        if case == "random":
            claims += _distance_claims(np.array(cuts))
    return claims


def _of_printed(criterion: str, v: Floats, rng: np.random.Generator) -> str:
    """What the printed partition of two peaks gives on (3.16) and on the narrower peaks it is the best for."""
    errors = []
    for case in ("two_peaks", "two_peaks_narrow"):
        model = original(scaled_weights(case, rng))
        wanted = output(model, v)
        printed = merge(model, _CUTS["3.5.3", "two_peaks", criterion])
        errors.append(100 * rmse(printed, v, wanted) / np.ptp(wanted))
    return f"; the printed partition gives {errors[0]:.2f} % on (3.16) and {errors[1]:.2f} % with 4 in its exponents"


def _distance_claims(cuts: NDArray[np.int64]) -> list[Claim]:
    """How far the cuts (draws, criterion, cut) of random weights are from uniform ones, against Table 3.5."""
    found = np.abs(cuts - np.array(UNIFORM)).max(axis=2)
    claims = []
    for k, (name, printed) in enumerate(_RANDOM_CUTS.items()):
        published = float(np.abs(np.array(printed) - np.array(UNIFORM)).max())
        claims.append(
            Claim(f"3.5.4.random_{name}_distance", "3.5.4",
                  f"Largest distance of the cuts of Entropy {name.capitalize()} from uniform ones, random case", published,
                  float(found[:, k].mean()), "1", at_most(published),
                  f"published {printed} of one draw, 'almost uniformly'; mean over {RANDOM_DRAWS} draws, from "
                  f"{found[:, k].min()} to {found[:, k].max()}")
        )  # fmt: skip
    return claims


def _bias_shift(rng: np.random.Generator) -> float:
    """Largest shift of the bias by compression over the four cases, over the output range."""
    shifts = []
    for _, case in _ERRORS:
        model = original(scaled_weights(case, rng))
        reduced = [
            merge(model, UNIFORM),
            compress(model, GROUPS).model,
            compress(model, GROUPS, criterion="max").model,
        ]
        span = np.ptp(output(model, damped_sine()))
        shifts += [abs(m.bias - model.bias) / span for m in reduced]
    return float(max(shifts))


def _against_exhaustive(radii: Floats, weights: Floats) -> tuple[list[int], list[float], list[float], float]:
    groups, fast, slow, worst = [2, 3, 4, 5], [], [], 1.0
    partition(radii, weights, 2)
    loss = {
        (a, b): group_loss(radii[a:b], weights[a:b]) for a in range(PLAYS) for b in range(a + 1, PLAYS + 1)
    }
    for m in groups:
        started = time.perf_counter()
        for _ in range(10):
            found = partition(radii, weights, m).loss
        fast.append((time.perf_counter() - started) / 10)
        started = time.perf_counter()
        best = math.inf
        for inner in itertools.combinations(range(1, PLAYS), m - 1):
            best = min(best, sum(loss[pair] for pair in itertools.pairwise((0, *inner, PLAYS))))
        slow.append(time.perf_counter() - started)
        worst = max(worst, found / best)
    return groups, fast, slow, worst


def _against_output_optimisation(
    rng: np.random.Generator, progress: Callable[[str, float], None]
) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Training RMSE (draws, 2), RMSE on random inputs (draws, inputs, 2), error traces of the first draw."""
    training, testing = np.empty((RANDOM_DRAWS, 2)), np.empty((RANDOM_DRAWS, RANDOM_INPUTS, 2))
    shown: dict[str, Floats] = {}
    v = third_order_reversal()
    for draw_number in range(RANDOM_DRAWS):
        progress(f"output optimisation, draw {draw_number + 1}", 0.2 + 0.8 * draw_number / RANDOM_DRAWS)
        model = original(scaled_weights("random", rng))
        entropy = compress(model, GROUPS).model
        found = {"Entropy Sum": entropy, "output optimisation": output_optimised(model, v, entropy, rng)}
        wanted = output(model, v)
        training[draw_number] = [rmse(m, v, wanted) for m in found.values()]
        if not shown:
            shown = {name: output(m, v) - wanted for name, m in found.items()}
        for k in range(RANDOM_INPUTS):
            probe = ramps(np.r_[SPAN[0], random_levels(*SPAN, 20, seed=rng)])
            answer = output(model, probe)
            testing[draw_number, k] = [rmse(m, probe, answer) for m in found.values()]
    return training, testing, shown
