"""Calibrate the probability that a name is wrong by what it leaves, on finished challenges; print its reliability.

    python -m vo2_studies.challenge.calibrate DIR [DIR ...]

The log odds of a wrong name are linear in the logarithm of the share that functions without a name predict beyond the
answer, and in the share of the excess that is not explained. Each family of
concealed hysteresis is predicted by coefficients that were fitted to the others; the last line has those fitted to all.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from vo2_studies.challenge.figures import interval
from vo2_studies.challenge.judging import judge, named
from vo2_studies.challenge.runner import load_json

__all__ = ["Named", "calibrated", "features", "left_out", "main", "reliability_of_names"]

Floats = NDArray[np.float64]
LIMITS = ("else_base", "else_open", "else_left")
"""Coefficients among the limits of a diagnosis: constant, per decade that is predictable, for what is not explained."""
PRIOR = ((4.2, 3.0), (3.0, 1.5), (2.0, 2.0))
"""Mean and standard deviation of each coefficient beforehand: as probable as not at 4 per cent predictable, a thirtieth at
nothing, e^2 times the odds where nothing is explained. Some tens of names with few wrong ones tell little more."""
EDGES = (0.0, 0.5, 0.8, 0.9, 0.95, 1.0)
"""Bins of the probability that a name is right."""


@dataclass(frozen=True)
class Named:
    """A diagnosis that names.

    Attributes
    ----------
    family : of the concealed hysteresis
    explained, predictable : what the name explains and leaves, as in the diagnosis
    right : whether every name is right
    in_use : coefficients that the diagnosis had
    """

    family: str
    explained: float
    predictable: float
    right: bool
    in_use: tuple[float, ...] = ()


def read_named(folder: Path) -> list[Named]:
    """Return the cases of a challenge's folder whose diagnosis names something."""
    found = []
    for file in sorted((folder / "results").glob("*.json")):
        answer, result = load_json(folder / "answers" / file.name), load_json(file)
        diagnosis: Mapping | None = result["diagnosis"]
        if diagnosis is None or not named(diagnosis) or not diagnosis.get("adequacy"):
            continue
        shares = diagnosis["adequacy"]
        right = not judge(answer, result).wrong
        limits = diagnosis["decision_limits"]
        in_use = tuple(float(limits[name]["value"]) for name in LIMITS)
        found.append(Named(answer["family"], shares["explained"], shares["predictable"], right, in_use))
    return found


def features(cases: Sequence[Named]) -> Floats:
    """Return what the log odds are linear in, (n, 3)."""
    return np.array([[1.0, np.log10(c.predictable + 0.003), 1.0 - c.explained] for c in cases])


def calibrated(cases: Sequence[Named]) -> Floats:
    """Return the coefficients (3,) of highest posterior density, the prior being `PRIOR`."""
    x, wrong = features(cases), np.array([not c.right for c in cases], dtype=float)
    mean, spread = np.array(PRIOR).T

    def cost(coefficients: Floats) -> float:
        odds = x @ coefficients
        likelihood = np.sum(np.logaddexp(0.0, odds) - wrong * odds)
        return float(likelihood + 0.5 * np.sum(((coefficients - mean) / spread) ** 2))

    return np.asarray(minimize(cost, mean).x)


def left_out(cases: Sequence[Named]) -> Floats:
    """Return for every case the probability (n,) that it is right, by coefficients fitted to the other families."""
    out = np.empty(len(cases))
    for family in sorted({c.family for c in cases}):
        own = np.array([c.family == family for c in cases])
        others = [c for c in cases if c.family != family]
        coefficients = calibrated(others) if others else np.array(PRIOR)[:, 0]
        odds = features([c for c in cases if c.family == family]) @ coefficients
        out[own] = 1.0 / (1.0 + np.exp(odds))
    return out


def reliability_of_names(probability: Floats, right: Sequence[bool]) -> list[str]:
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
    """Run the command line; return 0, or 2 where no case names anything."""
    parser = argparse.ArgumentParser(
        prog="python -m vo2_studies.challenge.calibrate",
        description="Calibrate the probability of a wrong name on finished challenges, a family of hysteresis left out in turn.",
    )
    parser.add_argument("folders", type=Path, nargs="+", help="output folders of challenge")
    folders = parser.parse_args(argv).folders
    cases = [case for folder in folders for case in read_named(folder)]
    if not cases:
        print(
            f"calibrate: {', '.join(map(str, folders))}: found no named case, need output folders of challenge",
            file=sys.stderr,
        )
        return 2
    right = [c.right for c in cases]
    print(f"{len(cases)} cases with a name, {sum(right)} right; each family by coefficients of the others:")
    print("\n".join(reliability_of_names(left_out(cases), right)))
    print(f"fitted to all: {', '.join(f'{c:.2f}' for c in calibrated(cases))}")
    for present in sorted({c.in_use for c in cases}):
        print(f"in use:        {', '.join(f'{c:.2f}' for c in present)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
