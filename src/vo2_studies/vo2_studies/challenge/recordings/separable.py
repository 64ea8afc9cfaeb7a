"""How far a concealed change is from every other: `python -m vo2_studies.challenge.recordings.separable`.

A change that another one imitates to within what repeats of the recording differ by cannot be named by anybody who has one such
recording. That is asked of the measurement itself, which is known without the change: every other change, of the strength that
comes nearest, with a zero and a gain of its own, is made to it, and the r.m.s. distance is told in the distance of repeats. A
law that was fitted to another recording misses the device by more, so that a diagnosis separates less. Changes of the drive act
through the device: a dead time is the same as a late clock of the only response, a drift of the drive's gain is not asked about.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from vo2_models.command_line import refuse

from vo2_studies.challenge.recordings.changes import CHANGES, Change, largest_strength
from vo2_studies.challenge.recordings.draw import COUNTED_RATIO, MeasuredSettings
from vo2_studies.challenge.recordings.sets import judged

__all__ = ["main", "nearest_rival"]

Array = NDArray[np.floating]
ONE_WAY = (
    "sensor_lag",
    "averaging",
    "clock_offset",
    "adc_saturation",
    "adc_quantization",
    "backlash",
    "leakage_resistance",
)
"""Changes that have no opposite; the others are tried with both signs."""
STRENGTHS = np.linspace(-4.0, 1.0, 21)
"""Decades of the largest strength that is concealed, at which a search begins: what imitates may be larger."""
CONSTANTS = "constants"
LATE = ("dead_time", "clock_offset")
ASIDE = "drive_gain_drift"
"""Not asked about: what it does, the device decides."""


def nearest_rival(time_s: Array, values: Array, altered: Array, unit: str, own: str) -> tuple[str, float]:
    """Return the change that comes nearest to an altered response, and the r.m.s. distance that it leaves.

    Parameters
    ----------
    time_s, values, altered : (n,) each, in the response's unit
    unit : of the response; a resistance is judged by its logarithm, and so is the distance
    own : id of the change that was made

    Returns
    -------
    id of the other change, "constants" for a moved zero and gain alone; distance
    """
    since = time_s - time_s[0]
    plain = judged(values, unit)
    wanted = judged(altered, unit)

    def left(candidate: Array) -> float:
        """R.m.s. distance with the best zero and, but for a resistance, the best gain."""
        if not np.all(np.isfinite(candidate)):
            return np.inf
        off = wanted - candidate
        columns = [np.ones_like(plain)] if unit == "ohm" else [np.ones_like(plain), plain]
        basis = np.column_stack(columns)
        return float(np.sqrt(np.mean((off - basis @ np.linalg.lstsq(basis, off, rcond=None)[0]) ** 2)))

    def by(change: Change, sign: float) -> float:
        most = sign * largest_strength(change, since, values)

        def at(decades: float) -> float:
            changed = change.alter(since, values, most * 10.0**decades)
            return left(judged(np.maximum(changed, 1e-9), unit) if unit == "ohm" else changed)

        tried = [at(x) for x in STRENGTHS]
        place = int(np.argmin(tried))
        low, high = STRENGTHS[max(place - 1, 0)], STRENGTHS[min(place + 1, STRENGTHS.size - 1)]
        found = minimize_scalar(at, bounds=(low, high), method="bounded", options={"xatol": 1e-3})
        return min(tried[place], float(found.fun))

    distances = {CONSTANTS: left(plain)}
    for change in CHANGES:
        twin = own in LATE and change.id in LATE
        if change.before or twin or change.id == own or (change.units and unit not in change.units):
            continue
        signs = (1.0,) if change.id in ONE_WAY else (1.0, -1.0)
        distances[change.id] = min(by(change, sign) for sign in signs)
    name = min(distances, key=lambda key: distances[key])
    return name, distances[name]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one line a case of those that `challenge --recordings` draws with the same options, and the counts."""
    parser = argparse.ArgumentParser(prog="separable", description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", required=True, metavar="DIR", help="folder of the measurements")
    parser.add_argument(
        "--cases", type=int, default=56, help="of `challenge`, of which the changed ones are taken (56)"
    )
    parser.add_argument("--seed", type=int, nargs="+", default=[1], help="one or several (1)")
    options = parser.parse_args(arguments)
    apart: list[float] = []
    same = 0
    for seed in options.seed:
        settings = MeasuredSettings(seed, options.recordings)
        try:
            cases = [settings.case(settings.plan(index)) for index in range(options.cases)]
        except ValueError as error:
            return refuse("separable", error)
        for case in cases:
            own = case.plan.effects[0] if case.plan.effects else ASIDE
            if own == ASIDE:
                continue
            (measured,) = (one for one in settings.sets if one.name == case.plan.device)
            before, (entry,) = measured.others[case.plan.condition], case.answer["effects"]
            values, altered = before[measured.response], case.test.measurement[measured.response]
            if own == "dead_time":
                delay = entry["parameters"]["delay"]["value"]
                altered = np.interp(before.time_s - delay, before.time_s, values)
            name, distance = nearest_rival(before.time_s, values, altered, measured.unit, own)
            distance /= measured.spread
            if entry["ratio"] > COUNTED_RATIO and own in LATE:
                same += 1
            elif entry["ratio"] > COUNTED_RATIO:
                apart.append(distance)
            print(
                f"{seed} case {case.plan.index:3d}  {measured.name:11s}{own:22s}{entry['ratio']:6.1f} spreads of repeats, "
                f"{distance:6.2f} from {name}",
                flush=True,
            )
    print(
        f"of {same + len(apart)} changes above {COUNTED_RATIO:g} spreads of repeats {same} are dead times and late clocks, "
        f"which are the same; of the others the nearest leaves "
        + ", ".join(f"{sum(one > x for one in apart)} more than {x:g}" for x in (1.0, 3.0))
        + " spreads"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
