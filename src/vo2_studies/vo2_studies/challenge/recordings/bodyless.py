"""Drawn devices without a heated body: a drive, one law of hysteresis, a memoryless part, a lag, one response, noise.

What `challenge --recordings` does with measured devices, on laws of which no two are alike: of three cases one is unchanged,
in one a gain or a zero has moved, one has a known change of `changes`. Calibration and later recording are different paths.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import Recording

from vo2_studies.challenge.draw import Case, Recorded
from vo2_studies.challenge.effect import either_sign, log_uniform
from vo2_studies.challenge.families import Statistics, chosen_families, draw_film
from vo2_studies.challenge.families.law import trace
from vo2_studies.challenge.filters import lag
from vo2_studies.challenge.plan import CasePlan
from vo2_studies.challenge.recordings.changes import CHANGES
from vo2_studies.challenge.recordings.draw import answer_of, conceal
from vo2_studies.challenge.recordings.sets import MeasuredSet

__all__ = ["BodylessSettings"]

KINDS = ("none", "moved", "one")
SAMPLES = 1500
SPREAD = 0.005
"""Share of the range that counts as one spread of repeats. Assumed: such a device is not repeated here."""
RATIOS = (4.0, 40.0)
"""Size of a change over that: 2 to 20 % of the range, r.m.s."""
GAIN, ZERO = (0.03, 0.2), (0.02, 0.1)
"""Smallest and largest move of a gain, and of a zero as a share of the range."""
DRIVES = {"V": 10.0, "T": 1.0, "m": 1e-3, "A": 2.0, "N": 50.0}
RESPONSES = {"m": 1e-4, "N": 20.0, "A m2": 1e-6, "ohm": 1e4}
"""Units, and a typical range."""
MISFIT = 0.15
"""Scatter of the law's parts."""


@dataclass(frozen=True)
class BodylessSettings:
    """What decides the cases; the same interface as `runner.Settings`.

    Attributes
    ----------
    seed : of everything
    family : of the hysteresis, see `families.chosen_families`
    kinds : some of `KINDS`; empty for all in turn
    """

    seed: int
    family: str
    kinds: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise a `ValueError` for a kind or a family that cannot be drawn."""
        for kind in self.kinds:
            if kind not in KINDS:
                raise ValueError(f"kinds: found {kind!r}, need some of {', '.join(KINDS)} for such devices")
        chosen_families(self.family)

    def plan(self, index: int) -> CasePlan:
        """Return the plan of case `index`: kinds, laws and changes in turn, in shuffled decks."""
        kinds = self.kinds or KINDS
        number, place = divmod(index, len(kinds))
        families = chosen_families(self.family)
        deck, card = divmod(number, len(families))
        family = families[
            int(np.random.default_rng([self.seed, 81, place, deck]).permutation(len(families))[card])
        ]
        kind = kinds[place]
        effects: tuple[str, ...] = ()
        if kind == "one":
            deck, card = divmod(number, len(CHANGES))
            order = np.random.default_rng([self.seed, 83, deck]).permutation(len(CHANGES))
            effects = (CHANGES[int(order[card])].id,)
        return CasePlan(index, kind, "bodyless", effects, family=family, condition="clean", excitation="own")

    def case(self, plan: CasePlan) -> Case:
        """Draw the case of `plan`."""
        rng = np.random.default_rng([self.seed, 87, plan.index])
        change = next((one for one in CHANGES if one.id in plan.effects), None)
        drawn = _device(rng, plan.family, change.units if change else ())
        test = drawn.others["later"]
        entries: list[dict] = []
        moved: list[dict] = []
        if change is not None:
            test, entry = conceal(drawn, test, change, log_uniform(rng, *RATIOS))
            entries.append(entry)
        elif plan.kind == "moved":
            test, moved = _moved(rng, drawn, test)
        answer = answer_of(plan, drawn, entries, moved, counted_ratio=RATIOS[0])
        return Case(
            plan, None, Recorded(drawn.calibration, None), Recorded(test, None), answer, drawn.document
        )


def _device(rng: np.random.Generator, family: str, units: tuple[str, ...]) -> MeasuredSet:
    """Draw a device, its calibration and a later recording."""
    drive_unit, unit = str(rng.choice(list(DRIVES))), str(rng.choice(list(units or RESPONSES)))
    size = DRIVES[drive_unit] * log_uniform(rng, 0.3, 3.0)
    low = -size * float(rng.uniform(0.0, 1.0))
    period = log_uniform(rng, 0.002, 1.0)  # s
    width = log_uniform(rng, 3.0, 15.0)
    statistics = Statistics(
        float(rng.uniform(55, 66)), log_uniform(rng, 3.0, 9.0), width, 0.3 * width, 0.0, 0.0, 5 * period
    )
    law = draw_film(rng, statistics, misfit=MISFIT, family=family).metal
    straight, bent = float(rng.uniform(-0.3, 0.6)), float(rng.uniform(-0.2, 0.2))
    delay = log_uniform(rng, 0.3, 4.0) * period if rng.random() < 0.5 else 0.0
    scale = log_uniform(rng, 0.5, 3.0) if unit == "ohm" else RESPONSES[unit] * log_uniform(rng, 0.2, 5.0)
    zero = np.log10(RESPONSES["ohm"]) if unit == "ohm" else scale * float(rng.uniform(-0.5, 0.5))
    noise = log_uniform(rng, 3e-4, 3e-3) * scale
    names = ("drive", "film_resistance" if unit == "ohm" else "response")

    def record() -> Recording:
        share = _path(rng)
        shape = trace(law, 30.0 + 60.0 * share, 0.0, period) + straight * share + bent * share**2
        if delay:
            shape = lag(shape, period, delay)
        values = zero + scale * shape + noise * rng.standard_normal(share.size)
        response = 10**values if unit == "ohm" else values
        channels = {
            names[0]: np.float64(low) + size * share,
            names[1]: np.asarray(response, dtype=np.float64),
        }
        time = period * np.arange(share.size, dtype=np.float64)
        return Recording(time, channels, "bodyless")

    calibration, later = record(), record()
    judged = np.log10(calibration[names[1]]) if unit == "ohm" else calibration[names[1]]
    document: dict[str, Any] = {
        "schema": "vo2-device/1",
        "id": "bodyless",
        "drive": {
            "channel": names[0],
            "unit": drive_unit,
            "limits": [low - 0.05 * size, low + 1.05 * size],
            "operating": [low, low + size],
        },
        "body": {"kind": "none"},
        "responses": {names[1]: {"unit": unit} | ({"scale": "log10"} if unit == "ohm" else {})},
        "sampling": {"period": float(f"{period:.3g}")},
    }
    spread = SPREAD * float(np.ptp(judged))
    return MeasuredSet("bodyless", document, *names, unit, calibration, {"later": later}, spread)


def _path(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a drive in shares of its range: a major loop, then ramps of two rates between random levels, with holds."""
    pieces = [np.linspace(0.0, 1.0, 150), np.linspace(1.0, 0.0, 150)[1:]]
    last, total = 0.0, 299
    while total < SAMPLES:
        level = float(rng.uniform(0.0, 1.0))
        count = max(3, round(abs(level - last) * (150 if rng.random() < 0.5 else 30)))
        held = int(rng.integers(10, 40)) if rng.random() < 0.2 else 0
        pieces += [np.linspace(last, level, count + 1)[1:], np.full(held, level)]
        last, total = level, total + count + held
    return np.concatenate(pieces)[:SAMPLES]


def _moved(rng: np.random.Generator, drawn: MeasuredSet, test: Recording) -> tuple[Recording, list[dict]]:
    """Return the recording with its gain or its zero moved, and what the answer says of it."""
    values = test[drawn.response]
    if drawn.unit == "ohm":
        by, name, unit = either_sign(rng, log_uniform(rng, *GAIN)), "film_scale", "1"
        after = values * (1 + by)
    elif rng.random() < 0.5:
        by, name, unit = either_sign(rng, log_uniform(rng, *GAIN)), "deflection_scale", "1"
        after = values * (1 + by)
    else:
        by, name, unit = either_sign(rng, log_uniform(rng, *ZERO)), "deflection_zero", "of range"
        after = values + by * np.ptp(drawn.calibration[drawn.response])
    entry = {"constant": name, "by": float(by), "unit": unit}
    return replace(test, channels={**test.channels, drawn.response: after}), [entry]
