"""5.3 and 5.4: the non-monotonic Preisach model, its predictions and its inverse, on simulated devices."""

from __future__ import annotations

from vo2_models.preisach.nonmonotonic_study import PUBLISHED_PERCENT, nonmonotonic_study

from vo2_identification.reproduce.claims import Claim, Context, Section, at_most

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
                at_most(published),
                conditions,
            )
        )
        claims.append(
            Claim(
                f"{section}.{name}_ratio", section, f"{words}: proposed over polynomial",
                published / PUBLISHED_PERCENT[quantity]["polynomial"], ours["proposed"] / ours["polynomial"], "1",
                at_most(1.0), conditions,
            )
        )  # fmt: skip
    claims.append(
        Claim("5.4.1.temperatures", "5.4.1", "Most temperatures that one desired output needs", 2.0,
              float(study.most_temperatures), "1", at_most(2.0), conditions)
    )  # fmt: skip
    return Section(NUMBER, TITLE, tuple(claims))
