"""8.7: H-infinity designed from the identified model, the composite estimate in its loop, on the ROS graph; both presets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_control.model_hinf import robust_from_model
from vo2_models.device import preset, truth

from vo2_studies.demo.errors import tracking_error
from vo2_studies.reproduce.claims import Claim, Context, Figure, Section, at_most
from vo2_studies.reproduce.figures import draw
from vo2_studies.reproduce.graph_sections import tracks, tried
from vo2_studies.reproduce.identified import identify
from vo2_studies.reproduce.peltier import reference
from vo2_studies.reproduce.scenarios import GraphLoop, run_loops
from vo2_studies.reproduce.sections.chapter_7 import references

NUMBER, TITLE = "8.7", "H-infinity from the identified model on the ROS graph"

LAWS = {"H-infinity": "hinf", "PI": "pi"}
_LIMIT_UM = {"integrated": 2.43, "peltier": 1.02}
"""Published: mean error of PI on the composite estimate (7.4.3); RMSE of H-infinity on the polynomial estimate (8.4.2)."""


def experiments() -> dict[str, tuple[NDArray[np.float64], int]]:
    """Preset -> multi-frequency reference (n,) [m] at its period, samples at its head that do not count."""
    return {"integrated": (references()["multi"], 0), "peltier": reference("multi")}


def run(context: Context) -> Section:
    """Run both scenarios; about two minutes."""
    claims: list[Claim] = []
    figures: list[Figure] = []
    remarks: list[str] = []
    for device, (wanted, lead) in experiments().items():
        context.progress(f"identifying {device}", 0.0 if device == "integrated" else 0.5)
        _, parameters = identify(truth(device, seed=context.seed), context.seed)
        robust = robust_from_model(parameters, preset(device).sample_period)
        loops = [
            GraphLoop(f"/{kind}", {"kind": "composite", **parameters}, {"kind": kind, **parameters})
            for kind in LAWS.values()
        ]
        folder = context.folder / "scenarios" / f"{NUMBER}_{device}"
        found, failure = tried(
            lambda loops=loops, device=device, wanted=wanted, lead=lead, folder=folder: dict(  # type: ignore[misc]
                zip(LAWS, run_loops(loops, device, context.seed, wanted, lead, folder), strict=True)
            )
        )
        errors = {name: 1e6 * tracking_error(found[name]) if found else np.nan for name in LAWS}
        basis = (
            f"{device}, one device (seed {context.seed}) in lockstep, composite estimate, both laws from the same identified "
            f"model; Ms {robust.worst.sensitivity_peak:.2f}, Mt {robust.worst.complementary_peak:.2f} where worst; mean error, "
            "multi-frequency reference"
        )
        claims += [
            Claim(f"8.7.{device}.error", "8.7", f"Mean tracking error of H-infinity from the model, {device}", None,
                  errors["H-infinity"], "um", at_most(_LIMIT_UM[device]), basis),
            Claim(f"8.7.{device}.ratio", "8.7", f"Mean tracking error of H-infinity over that of PI, {device}", None,
                  errors["H-infinity"] / errors["PI"], "1", at_most(1.0), basis),
        ]  # fmt: skip
        if found:
            figures.append(
                draw(f"{device}, device of seed {context.seed}.", tracks(found), rows=2, height=2.4)
            )
        if failure:
            remarks.append(f"{device}: {failure}")
    return Section(NUMBER, TITLE, tuple(claims), tuple(figures), tuple(remarks))
