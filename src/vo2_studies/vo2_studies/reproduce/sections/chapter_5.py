"""5.3 and 5.4: the non-monotonic Preisach model, its predictions and its inverse, on simulated devices."""

from __future__ import annotations

import numpy as np
from vo2_models.hysteresis.preisach.nonmonotonic import fit_nonmonotonic
from vo2_models.hysteresis.preisach.nonmonotonic_inverse import NonMonotonicInverse
from vo2_models.identification.excitation import random_levels

from vo2_studies.preisach.nonmonotonic_study import LEVEL, PUBLISHED_PERCENT, TRANSITION, nonmonotonic_study
from vo2_studies.preisach.polynomial import fit_polynomial
from vo2_studies.reproduce.claims import Claim, Context, Figure, Section, at_most, within, within_or_below
from vo2_studies.reproduce.figures import draw
from vo2_studies.reproduce.film import COLD, HOT, cantilever, excitation

NUMBER, TITLE = "5", "Non-monotonic Preisach model and inverse compensation"

DEVICES = 5
_WORDS = {
    "fit max": ("5.3.2", "Largest error of the fit"),
    "prediction max": ("5.3.2", "Largest prediction error, random temperatures"),
    "inverse max": ("5.4.2", "Largest error of open-loop inverse compensation"),
    "inverse rms": ("5.4.2", "Root mean square error of open-loop inverse compensation"),
}


def run(context: Context) -> Section:
    """Return the section's claims; about a second."""
    context.progress(f"{DEVICES} devices: identify, predict, invert", 0.1)
    study = nonmonotonic_study(devices=DEVICES, seed=context.seed)
    claims = []
    conditions = (
        f"of the curvature range; mean over {DEVICES} simulated devices, the published value is of one device"
    )
    for quantity, (section, words) in _WORDS.items():
        published = PUBLISHED_PERCENT[quantity]["proposed"]
        ours = study.percent[quantity]
        name = quantity.replace(" ", "_")
        claims.append(
            Claim(
                f"{section}.{name}",
                section,
                words,
                published,
                ours["proposed"],
                "%",
                within_or_below(published, 0.1),
                conditions,
            )
        )
        claims.append(
            Claim(
                f"{section}.{name}_ratio", section, f"{words}: proposed over polynomial",
                published / PUBLISHED_PERCENT[quantity]["polynomial"], ours["proposed"] / ours["polynomial"], "1",
                within_or_below(published / PUBLISHED_PERCENT[quantity]["polynomial"], 0.1), conditions,
            )
        )  # fmt: skip
        claims += [
            Claim(f"{section}.{name}_{other.lower().replace(' ', '_')}", section, f"{words}: {other}", theirs, ours[other], "%",
                  within(theirs, 0.2), conditions)
            for other, theirs in PUBLISHED_PERCENT[quantity].items() if other != "proposed"
        ]  # fmt: skip
    claims.append(
        Claim("5.4.1.temperatures", "5.4.1", "Most temperatures that one desired output needs", 2.0,
              float(study.most_temperatures), "1", at_most(2.0), conditions)
    )  # fmt: skip
    signed, theirs = study.percent["prediction max"], PUBLISHED_PERCENT["prediction max"]
    claims.append(
        Claim("5.3.2.prediction_max_signed", "5.3.2", "Largest prediction error: proposed over signed Preisach",
              theirs["proposed"] / theirs["signed Preisach"], signed["proposed"] / signed["signed Preisach"], "1",
              within_or_below(theirs["proposed"] / theirs["signed Preisach"], 0.1), conditions)
    )  # fmt: skip
    context.progress("figures", 0.7)
    return Section(NUMBER, TITLE, tuple(claims), _figures(context.seed))


def _figures(seed: int) -> tuple[Figure, ...]:
    """Loops, prediction errors and open-loop tracking of the first device."""
    device = cantilever(seed)
    temperature = excitation()
    curvature = device(temperature, 1)
    proposed = fit_nonmonotonic(temperature, curvature, np.linspace(*TRANSITION, LEVEL + 1))
    polynomial = fit_polynomial(temperature, curvature)
    rng = np.random.default_rng(seed)
    probe = np.r_[COLD, random_levels(COLD, HOT, 200, seed=rng)]
    answer = device(probe, 2)
    inverse = NonMonotonicInverse(proposed)
    # as Fig. 5.11: a wide range, then magnitudes that change
    t = np.arange(150)
    middle, half = (
        0.5 * (inverse.maximum[1] + inverse.minimum[1]),
        0.5 * (inverse.maximum[1] - inverse.minimum[1]),
    )
    wanted = middle - 0.97 * half * np.cos(0.13 * t) * np.exp(-t / 200)
    state = proposed.operator.initial_memory()
    steps = [inverse.update(float(k), state).temperatures for k in wanted]
    reached = {
        "proposed": device(np.r_[COLD, np.concatenate(steps)], 3)[np.cumsum([len(s) for s in steps])],
        "polynomial": device(np.r_[COLD, polynomial.inverse(wanted)], 3)[1:],
    }

    def loops(axis):
        axis.plot(temperature, curvature, ".", ms=2, color="#888", label="measured (simulated device)")
        axis.plot(temperature, proposed(temperature), "-", lw=0.8, label="non-monotonic Preisach model")
        ordered = np.sort(temperature)
        axis.plot(ordered, polynomial(ordered), "--", label="polynomial")
        axis.set_xlabel("temperature [degC]")
        axis.set_ylabel("curvature [1/m]")

    def prediction(top, bottom):
        top.step(np.arange(probe.size), probe, where="post", color="k", lw=0.8)
        top.set_ylabel("temperature [degC]")
        guesses = {"polynomial": polynomial(probe), "proposed": proposed(probe)}
        for (name, guess), style in zip(guesses.items(), ("--", "-"), strict=True):
            bottom.plot(guess - answer, style, lw=1, label=name)
        bottom.set_xlabel("sample [1]")
        bottom.set_ylabel("error [1/m]")

    def tracking(top, bottom):
        top.plot(wanted, "k:", label="desired")
        for (name, values), style in zip(reached.items(), ("-", "--"), strict=True):
            top.plot(values, style, lw=1, label=name)
            bottom.plot(values - wanted, style, lw=1, label=name)
        top.set_ylabel("curvature [1/m]")
        bottom.set_ylabel("error [1/m]")
        bottom.set_xlabel("sample [1]")

    return (
        draw("Fig. 5.4 and 5.6: nested loops of the first device and the models.", loops),
        draw("Fig. 5.9: a random temperature sequence and the prediction errors.", prediction, rows=2, height=2.4),
        draw("Fig. 5.11: open-loop inverse compensation by the proposed model and by the polynomial.", tracking,
             rows=2, height=2.4),
    )  # fmt: skip
