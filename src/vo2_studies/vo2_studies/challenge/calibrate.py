"""Calibrate the probability that an explanation is wrong, on finished challenges; print its reliability.

    python -m vo2_studies.challenge.calibrate DIR [DIR ...]

Every diagnosis with an explanation counts, whether it was named or not. The log odds of a wrong one are linear in the
logarithms of how surely its effects act and of what it leaves. Each family of concealed hysteresis is predicted by
coefficients that were fitted to the others; the last line has those fitted to all.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from vo2_studies.challenge.figures import interval
from vo2_studies.challenge.runner import load_json

__all__ = ["Explained", "calibrated", "features", "left_out", "main", "read_explained", "reliability"]

Floats = NDArray[np.float64]
LIMITS = ("else_base", "else_sure", "else_left")
"""Coefficients among the limits of a diagnosis: constant, per decade of certainty, per decade of what is left."""
PRIOR = ((4.0, 3.0), (3.0, 1.5), (2.0, 1.5))
"""Mean and standard deviation of each coefficient beforehand: as probable as not at 20 standard deviations where nothing is
left, ten times the odds or more for a decade of either."""
EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)
"""Bins of the probability that a name is right."""


@dataclass(frozen=True)
class Explained:
    """A diagnosis with an explanation.

    Attributes
    ----------
    family : of the concealed hysteresis
    sure, left : decades of how surely it acts and of what it leaves, as the diagnosis counts them
    right : whether all its effects were concealed, in this form or a sibling's
    in_use : coefficients that the diagnosis had
    """

    family: str
    sure: float
    left: float
    right: bool
    in_use: tuple[float, ...] = ()


def read_explained(folder: Path) -> list[Explained]:
    """Return the cases of a challenge's folder whose diagnosis has an explanation."""
    found = []
    for file in sorted((folder / "results").glob("*.json")):
        answer, result = load_json(folder / "answers" / file.name), load_json(file)
        diagnosis: Mapping | None = result["diagnosis"]
        adequacy = diagnosis.get("adequacy") or {} if diagnosis else {}
        if diagnosis is None or not {"of", "sigmas", "left"} <= adequacy.keys():
            continue  # none, one that the values show by themselves, or of an older version
        limits = {name: float(limit["value"]) for name, limit in diagnosis["decision_limits"].items()}
        concealed = {name for e in answer["effects"] for name in (e["id"], *e["siblings"])}
        right = set(adequacy["of"]) <= concealed
        in_use = tuple(limits[name] for name in LIMITS)
        sure = math.log10(min(max(adequacy["sigmas"], 1.0), limits["surest"]))
        left = math.log10(1.0 + adequacy["left"] / limits["least"])
        found.append(Explained(answer["family"], sure, left, right, in_use))
    return found


def features(cases: Sequence[Explained]) -> Floats:
    """Return what the log odds of a wrong explanation are linear in, (n, 3)."""
    return np.array([[1.0, -c.sure, c.left] for c in cases])


def calibrated(cases: Sequence[Explained]) -> Floats:
    """Return the coefficients (3,) of highest posterior density, the prior being `PRIOR`."""
    x, wrong = features(cases), np.array([not c.right for c in cases], dtype=float)
    mean, spread = np.array(PRIOR).T

    def cost(coefficients: Floats) -> float:
        odds = x @ coefficients
        likelihood = np.sum(np.logaddexp(0.0, odds) - wrong * odds)
        return float(likelihood + 0.5 * np.sum(((coefficients - mean) / spread) ** 2))

    return np.asarray(minimize(cost, mean).x)


def left_out(cases: Sequence[Explained]) -> Floats:
    """Return for every case the probability (n,) that it is right, by coefficients fitted to the other families."""
    out = np.empty(len(cases))
    for family in sorted({c.family for c in cases}):
        own = np.array([c.family == family for c in cases])
        others = [c for c in cases if c.family != family]
        coefficients = calibrated(others) if others else np.array(PRIOR)[:, 0]
        odds = features([c for c in cases if c.family == family]) @ coefficients
        out[own] = 1.0 / (1.0 + np.exp(odds))
    return out


def reliability(probability: Floats, right: Sequence[bool]) -> list[str]:
    """Return one line for each bin: stated range, count, mean stated, share that is right, 95 % interval."""
    truth = np.asarray(right, dtype=bool)
    place = np.clip(np.searchsorted(EDGES, probability, side="right") - 1, 0, len(EDGES) - 2)
    lines = []
    for k in np.unique(place):
        own = truth[place == k]
        low, high = interval(int(own.sum()), own.size)
        lines.append(
            f"{EDGES[k]:.2f} to {EDGES[k + 1]:.2f}  n {own.size:3d}  stated {probability[place == k].mean():.3f}  "
            f"right {own.mean():.3f} [{low:.2f}, {high:.2f}]"
        )
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, or 2 where no case has an explanation."""
    parser = argparse.ArgumentParser(
        prog="python -m vo2_studies.challenge.calibrate",
        description="Calibrate the probability of a wrong explanation on finished challenges, a family left out in turn.",
    )
    parser.add_argument("folders", type=Path, nargs="+", help="output folders of challenge")
    folders = parser.parse_args(argv).folders
    cases = [case for folder in folders for case in read_explained(folder)]
    if not cases:
        print(
            f"calibrate: {', '.join(map(str, folders))}: found no case with an explanation, need output folders of challenge",
            file=sys.stderr,
        )
        return 2
    right = [c.right for c in cases]
    print(
        f"{len(cases)} cases with an explanation, {sum(right)} right; each family by coefficients of the others:"
    )
    print("\n".join(reliability(left_out(cases), right)))
    print(f"fitted to all: {', '.join(f'{c:.2f}' for c in calibrated(cases))}")
    for present in sorted({c.in_use for c in cases}):
        print(f"in use:        {', '.join(f'{c:.2f}' for c in present)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
