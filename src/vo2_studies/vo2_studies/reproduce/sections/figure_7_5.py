"""7.1.3: loops of deflection over current and over resistance at several frequencies, Fig. 7.5."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_models.device import preset, truth
from vo2_models.device.simulation import TRUE_DEFLECTION, TRUE_RESISTANCE

from vo2_studies.reproduce.claims import Claim, Context, Section, at_least, at_most
from vo2_studies.reproduce.figures import STYLES, draw

NUMBER, TITLE = "7.1.3", "Rate-dependent loops"

Floats = NDArray[np.float64]

FREQUENCIES_HZ = (1.0, 10.0, 30.0, 100.0)
_PERIOD_S = 1e-4
_CYCLES = 3
_PLACES = 200
"""At which two loops are compared."""


def loops(seed: int | None, frequency_hz: float) -> tuple[Floats, Floats, Floats]:
    """Return current [A], log10 of the resistance in ohm, deflection [m] of the last cycle of a sinusoidal current."""
    low, high = preset("integrated").operating_range
    count = round(1.0 / (frequency_hz * _PERIOD_S))
    phase = 2.0 * np.pi * np.arange(_CYCLES * count) / count
    current = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(phase)
    played = truth("integrated", seed=seed).simulate(current, dt=_PERIOD_S, noise=False)
    last = slice(-count, None)
    return current[last], np.log10(played[TRUE_RESISTANCE][last]), played[TRUE_DEFLECTION][last]


def branches(abscissa: Floats, deflection: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Split one closed cycle at the extremes of the abscissa: rising and falling branch, each with rising abscissa."""
    start = int(np.argmin(abscissa))
    x, y = np.roll(abscissa, -start), np.roll(deflection, -start)
    top = int(np.argmax(x))
    rising, falling = (x[: top + 1], y[: top + 1]), (x[top:][::-1], y[top:][::-1])
    return rising, falling


def change(first: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> float:
    """Return the mean distance of two loops in deflection [m], branch by branch, where both have the abscissa."""
    low, high = max(first[0].min(), other[0].min()), min(first[0].max(), other[0].max())
    places = np.linspace(low, high, _PLACES)
    gaps = []
    for (xa, ya), (xb, yb) in zip(branches(*first), branches(*other), strict=True):
        gaps.append(np.abs(np.interp(places, xa, ya) - np.interp(places, xb, yb)))
    return float(np.mean(gaps))


def run(context: Context) -> Section:
    """Return the section's claims; under a second."""
    cycles = {f: loops(context.seed, f) for f in FREQUENCIES_HZ}
    slow, fast = cycles[FREQUENCIES_HZ[0]], cycles[FREQUENCIES_HZ[-1]]
    over_current = change((slow[0], slow[2]), (fast[0], fast[2]))
    over_resistance = change((slow[1], slow[2]), (fast[1], fast[2]))
    extent = preset("integrated").deflection_range
    ends = f"{FREQUENCIES_HZ[0]:g} and {FREQUENCIES_HZ[-1]:g} Hz"
    conditions = f"device {context.seed}, sinusoid over the operating current, no noise; mean distance of the loops at {ends}"
    claims = (
        Claim("7.1.3.loop_over_current", "7.1.3", "Deflection over current changes dramatically with frequency", None,
              100 * over_current / extent, "%", at_least(5.0), conditions),
        Claim("7.1.3.loop_over_resistance", "7.1.3", "Deflection over resistance changes far less: share of that change",
              None, over_resistance / over_current, "1", at_most(0.2), conditions),
    )  # fmt: skip

    def plot(left, right):
        for (frequency, (current, resistance, deflection)), style in zip(cycles.items(), STYLES, strict=True):
            left.plot(1e3 * current, 1e6 * deflection, style, label=f"{frequency:g} Hz")
            right.plot(resistance, 1e6 * deflection, style, label=f"{frequency:g} Hz")
        left.set_xlabel("current [mA]")
        right.set_xlabel("log10 of the resistance in ohm")
        for axis in (left, right):
            axis.set_ylabel("deflection [um]")

    figure = draw(
        "Fig. 7.5: deflection over current and over resistance, by frequency.", plot, rows=2, height=2.8
    )
    return Section(NUMBER, TITLE, claims, (figure,))
