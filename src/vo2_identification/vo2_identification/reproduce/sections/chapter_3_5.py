"""3.5: optimal partitions of the uniform and the one-peak weight distribution."""

from __future__ import annotations

import numpy as np
from vo2_models.hysteresis.compression_gpi import partition

from vo2_identification.reproduce.claims import Claim, Context, Section, at_most

NUMBER, TITLE = "3.5", "Entropy-based compression of the GPI model"

_PLAYS, _GROUPS = 30, 6
_CASES = {
    # Tables 3.2 and 3.3
    ("3.5.1", "uniform", "sum"): (0, 5, 10, 15, 20, 25, 30),
    ("3.5.1", "uniform", "max"): (0, 5, 10, 15, 20, 25, 30),
    ("3.5.2", "one_peak", "sum"): (0, 11, 13, 14, 16, 18, 30),
    ("3.5.2", "one_peak", "max"): (0, 9, 12, 14, 16, 18, 30),
}


def run(context: Context) -> Section:
    """Return the section's claims; milliseconds once compiled."""
    j = np.arange(1, _PLAYS + 1)
    radii = j / (_PLAYS + 1)
    weights = {
        "uniform": np.full(_PLAYS, 0.5),  # (3.14)
        "one_peak": 5 / np.sqrt(2 * np.pi) * np.exp(-((j - 15) ** 2) / 15),  # (3.15)
    }
    claims = []
    for k, ((section, case, criterion), published) in enumerate(_CASES.items()):
        context.progress(f"{case}, Entropy {criterion}", k / len(_CASES))
        cuts = partition(radii, weights[case], _GROUPS, criterion="sum" if criterion == "sum" else "max").cuts
        claims.append(
            Claim(
                f"{section}.{case}_{criterion}", section,
                f"Cut indices of Entropy {criterion.capitalize()}, {case.replace('_', '-')} case, that differ from the table",
                0.0, float(np.sum(cuts != np.array(published))), "1", at_most(0.0),
                f"published {published}, ours {tuple(int(c) for c in cuts)}",
            )
        )  # fmt: skip
    return Section(NUMBER, TITLE, tuple(claims))
