"""What the text derives from its own figures, derived again: where it contradicts itself, nothing can be reproduced."""

from __future__ import annotations

import math
from dataclasses import dataclass

import control
import numpy as np
from vo2_control.pid import PUBLISHED_PELTIER_PID
from vo2_models.hysteresis.preisach.grid import cell_count

from vo2_studies.published_models import OPERATING, printed_deflection
from vo2_studies.reproduce.claims import Claim, Context, Section, at_most, within

NUMBER, TITLE = "1", "Arithmetic of the text: figures derived from other printed figures"


@dataclass(frozen=True)
class Derived:
    """One printed figure and what the figures it comes from give.

    `distance` is what rounding of the printed figures explains; `contradicts` says what they give instead.
    """

    section: str
    name: str
    words: str
    printed: float
    given: float | np.floating
    unit: str
    distance: float
    source: str
    contradicts: str = ""


def _less(small: float, large: float) -> float:
    """By how much one figure lies below another [%]."""
    return 100 * (1 - small / large)


def listed_evaluations(plays: int, groups: int) -> int:
    """Evaluations of the dynamic programme as section 3.2 lists them: the terminal cost, (3.6), and (3.7) stage by stage."""
    return plays + (plays - 1) + sum(plays - groups + k for k in range(1, groups - 1))


def groupings(plays: int, groups: int) -> int:
    """Ways to cut a row of plays into groups that are not empty, counted group by group."""
    ways = [1] + [0] * plays
    for _ in range(groups):
        ways = [sum(ways[:end]) for end in range(plays + 1)]
    return ways[plays]


def groups_in_use(plays: int, groups: int) -> int:
    """Different groups that occur in any of these partitions: the losses that (3.6) and (3.7) cannot do without."""
    return sum(
        # before and behind it at most as many groups as plays, and at least one where there are any
        any(
            min(start, 1) <= before <= start and min(plays - end, 1) <= groups - 1 - before <= plays - end
            for before in range(groups)
        )
        for start in range(plays)
        for end in range(start + 1, plays + 1)
    )


def _evaluations(plays: int, groups: int) -> list[Derived]:
    """What section 3.2 counts, at the numbers of 3.5.5."""
    n, m = plays, groups
    formula = m * (2 * n - m + 1) / 2
    at = f"N = {n}, M = {m}"
    return [
        Derived("3.2", "dynamic", f"Evaluations of the dynamic programme, M (2 N - M + 1) / 2, {at}", formula,
                float(listed_evaluations(n, m)), "1", 0.0, "the stages as the section lists them"),
        Derived("3.2", "exhaustive", f"Evaluations of the exhaustive search, (N - 1)! M / ((M - 1)! (N - M)!), {at}",
                m * math.factorial(n - 1) / (math.factorial(m - 1) * math.factorial(n - m)), float(m * groupings(n, m)), "1", 0.0,
                "partitions counted group by group, each of M groups"),
        Derived("3.2", "needed", f"Losses that the dynamic programme needs, each once, against its evaluations, {at}", formula,
                float(groups_in_use(n, m)), "1", 0.0, "the groups that occur in (3.6) and (3.7)",
                "(3.7) is a minimum over u_k at every state; the section counts one evaluation a state"),
    ]  # fmt: skip


def derived() -> list[Derived]:
    """All of them, in the order of the text."""
    cells = cell_count(30)
    table_72 = printed_deflection()
    memory = table_72.initial_memory()
    sweep = np.r_[np.linspace(*OPERATING, 200), np.linspace(*OPERATING[::-1], 200)]
    tip = np.array([table_72.step(float(current), memory) for current in sweep])
    spans = f"Table 7.2 over 3.68 to 8.49 mA gives {tip.min():.1f} to {tip.max():.1f} um, 7.3.1 has [1.62, 58.65] um"
    return [
        Derived("1.1.2", "measurements", "Measurements that 200 levels need", 20100.0, float(cell_count(200)), "1", 0.0,
                "L (L + 1) / 2"),
        Derived("2.4.1", "offset", "Offset of the operator", -3.308, (-4.28 - 2.34) / 2, "log10 ohm", 0.002,
                "the middle of [-4.28, -2.34] log10 ohm (2.4.2)"),
        Derived("2.4.1", "decades", "Change of the resistance, orders of magnitude", 2.0, 4.28 - 2.34, "1", 0.05,
                "[-4.28, -2.34] log10 ohm; 'approximately two'"),
        *_evaluations(plays=30, groups=7),
        Derived("3.5.3", "less", "Error of the entropy schemes below that of uniform compression", 40.0,
                np.mean([_less(0.27, 0.42), _less(0.20, 0.42)]), "%", 0.12, "Table 3.4: 36 and 52 %; 'about 40 %'"),
        Derived("3.5.4", "better", "Error of Entropy Sum over that of uniform compression, random case", 1.0, 0.54 / 0.53, "1",
                0.0, "Table 3.5", "'slightly better performance', while the table has 0.54 % and 0.53 % against 0.53 %"),
        Derived("3.6.1", "sum_less", "Entropy Sum below uniform compression", 32.0, _less(0.73, 1.10), "%", 0.06,
                "0.73 % and 1.10 %; 'about 32 %'"),
        Derived("3.6.1", "max_less", "Entropy Max below uniform compression", 32.0, _less(0.76, 1.10), "%", 0.06,
                "0.76 % and 1.10 %; 'about 32 %'"),
        *(
            Derived("3.6.2", f"scaling_{name}", f"What scaling gains, {name}", 15.0, _less(scaled, plain), "%", 0.34,
                    f"Table 3.7: {plain} and {scaled} %; '10-20 %'")
            for name, plain, scaled in (("uniform", 1.76, 1.45), ("sum", 1.21, 1.05), ("max", 0.87, 0.72))
        ),
        Derived("4.1", "cells", "Densities at level 30", 465.0, float(cells), "1", 0.0, "L (L + 1) / 2"),
        Derived("4.3", "noise", "Noise bound over the largest output", 0.23, 100 * 5.0 / (6.0 * cells), "%", 0.1,
                "noise on [-5, 5]; 465 densities of mean 6 in saturation",
                "the largest output of 465 densities uniform on [0, 12] is about 2790, of which 5 is 0.18 %"),
        Derived("4.4.2", "unknowns", "Unknowns with bias and linear term", 467.0, cells + 2.0, "1", 0.0, "465 densities and two"),
        Derived("5.1.2", "strain", "Strain of a plane that loses 1.7 % of its area", -0.083, np.sqrt(1 - 0.017) - 1, "1", 0.05,
                "the two lattice directions shrink alike",
                "-0.083 takes 16 % from the area, 8 % along one direction alone; -0.0083, a zero more, would follow"),
        Derived("5.3.2", "range", "Range of the curvature", 1950.0, 1846.0 + 104.0, "1/m", 0.0, "[-104, 1846] 1/m"),
        Derived("5.3.2", "prediction", "Largest prediction error over the range", 5.6, 100 * 108.1 / 1950, "%", 0.02,
                "108.1 and 1950 1/m; 'less than 5.6 %'"),
        Derived("5.4.2", "inverse", "Largest inversion error over the range", 4.1, 100 * 78 / (1814.0 + 63.0), "%", 0.02,
                "78 1/m of [-63, 1814] 1/m"),
        Derived("6.3.1", "rmse_less", "RMSE of the EGPI below that of the GPI", 31.0, _less(26.4, 38.5), "%", 0.02,
                "26.4 and 38.5 1/m"),
        Derived("6.3.1", "largest_less", "Largest error of the EGPI below that of the GPI", 40.0, _less(89.6, 148.9), "%", 0.02,
                "89.6 and 148.9 1/m"),
        Derived("6.3.2", "rmse_more", "RMSE of the GPI above that of the EGPI", 158.0, 100 * (0.031 / 0.012 - 1), "%", 0.01,
                "0.031 and 0.012"),
        Derived("6.3.2", "largest_more", "Largest error of the GPI above that of the EGPI", 100.0, 100 * (0.082 / 0.041 - 1), "%",
                0.01, "0.082 and 0.041"),
        Derived("7.1.3", "range_low", "Lower end of the deflection", 48.13, tip.min(), "um", 0.02, "Table 7.2, from saturation"),
        Derived("7.1.3", "range_high", "Upper end of the deflection", 72.15, tip.max(), "um", 0.02, "Table 7.2", spans),
        Derived("8.1.2", "sensitivity", "Sensitivity of the position sensor", 0.111, 7.8 / 70, "V/um", 0.01, "7.8 V and 70 um"),
        Derived("8.1.2", "resolution", "Resolution of the position sensor over its range", 1.4e-5, 0.2e-6 / 13.875e-3, "1", 0.04,
                "0.2 um and 13.875 mm"),
        Derived("8.3.1", "mean_heating", "Time constant", 25.0, np.mean([20.8, 22.6]), "s", 0.04, "Table 8.1, rows of heating",
                "'only heating steps were considered', of which the table's mean is 21.7 s; 25 s is that of all rows"),
        Derived("8.3.1", "gain", "Gain, from steady temperatures", 50.0,
                np.polyfit([0.2, 0.4, 0.6, 0.8], [39.7, 49.2, 59.1, 70.1], 1)[0], "K/A", 0.02, "slope of Table 8.1"),
        Derived("8.3.1", "room", "Temperature at zero current", 25.0,
                np.polyfit([0.2, 0.4, 0.6, 0.8], [39.7, 49.2, 59.1, 70.1], 1)[1], "degC", 0.02, "line through Table 8.1",
                "the line through the table meets zero current at 29 degC"),
        Derived("8.3.1", "spread_low", "Shortest time constant of the uncertainty", 20.0, 25 * 0.8, "s", 0.0, "25 (1 - 0.2)"),
        Derived("8.3.1", "spread_high", "Longest time constant of the uncertainty", 30.0, 25 * 1.2, "s", 0.0, "25 (1 + 0.2)"),
        Derived("8.4.1", "rmse_less", "RMSE of the robust controller below PID, steps", 3.66, _less(6.05, 6.28), "%", 0.01,
                "Table 8.2"),
        Derived("8.4.1", "steady_less", "Steady-state error below PID", 36.0, _less(0.62, 1.11), "%", 0.02, "Table 8.2",
                "0.62 is 44 % below 1.11"),
        Derived("8.4.2", "rmse_less", "RMSE below PID, multi-sine", 18.0, _less(1.02, 1.24), "%", 0.02, "Table 8.3"),
        Derived("8.4.2", "effort_less", "Effort below PID, multi-sine", 1.8, _less(48.2, 49.1), "%", 0.03, "Table 8.3"),
        Derived("8.4.3", "largest_less", "Largest error below PID, with noise", 28.0, _less(3.07, 4.28), "%", 0.02, "Table 8.4"),
        Derived("8.4.3", "largest_more", "Largest error of the PID, with noise above without", 43.0, 100 * (4.28 / 3.00 - 1),
                "%", 0.01, "Tables 8.3 and 8.4"),
        Derived("8.4.3", "rmse_less", "RMSE below PID, with noise", 34.7, _less(0.96, 1.47), "%", 0.01, "Table 8.4"),
        Derived("8.4.3", "effort_less", "Effort below PID, with noise", 6.0, _less(31.6, 33.6), "%", 0.01, "Table 8.4"),
        Derived("8.4.3", "rmse_more", "RMSE of the PID, with noise above without", 18.6, 100 * (1.47 / 1.24 - 1), "%", 0.01,
                "Tables 8.3 and 8.4"),
        Derived("8.4.3", "noise_share", "Noise amplitude over the total change of the current", 25.0, 100 * 10.0 / (2 * 49.1),
                "%", 0.1, "10 mA; a signal of s.d. 49.1 mA changes by 98 mA at least",
                "25 % makes the total change 40 mA, less than the s.d. in Table 8.3"),
        Derived("8.4.3", "band", "Band of the noise", 8.0, 4.0, "Hz", 0.0, "half of 1 / 125 ms",
                "a band of 8 Hz does not exist at 8 Hz sampling"),
    ]  # fmt: skip


def nominal_step(band: float = 0.02) -> tuple[float, float]:
    """Overshoot [%] and settling time to `band` [s] of the published PID on the chapter's linear model."""
    s = control.tf("s")
    delay = (1 - 0.1875 * s) / (1 + 0.1875 * s)
    plant = 5.9 * 50.0 * delay / (25.0 * s + 1)
    gains = PUBLISHED_PELTIER_PID
    kp, ki, kd = (1e-6 * abs(gain) for gain in (gains.kp, gains.ki, gains.kd))
    law = kp + ki / s + kd * s / (gains.derivative_filter_s * s + 1)
    loop = control.feedback(plant * law, 1)
    found = control.step_info(loop, T=np.linspace(0, 200, 20001), SettlingTimeThreshold=band)
    return float(found["Overshoot"]), float(found["SettlingTime"])


def run(context: Context) -> Section:
    """Return the section's claims; no simulation but that of the nominal PID loop."""
    claims = [
        Claim(f"text.{one.section}.{one.name}", one.section, one.words, one.printed, float(one.given), one.unit,
              within(one.printed, one.distance), f"from {one.source}", one.contradicts, derived=True)
        for one in derived()
    ]  # fmt: skip
    overshoot, settling = nominal_step()
    basis = "the printed gains on the nominal model of 8.3.1, Pade delay, linear; derivative filtered over one sample"
    claims += [
        Claim("text.8.4.overshoot", "8.4", "Overshoot that the PID was tuned for", 2.0, overshoot, "%", at_most(2.0), basis,
              "'less than 2 %' was designed on this model, on which the printed gains overshoot by 2.7 % (2.4 without delay)",
              derived=True),
        Claim("text.8.4.settling", "8.4", "Settling time that the PID was tuned for", 10.0, settling, "s", at_most(10.0),
              f"to 2 %; the text has no band: to 5 % it is {nominal_step(0.05)[1]:.1f} s; {basis}", derived=True),
    ]  # fmt: skip
    story = (
        "Published values here are figures that the text derives from others; 'ours' is what those others give. Where they "
        "differ by more than rounding, no measurement and no simulation can meet both. These lines are counted apart: that a "
        "figure follows from others is no reproduction of it.",
    )
    return Section(NUMBER, TITLE, tuple(claims), story=story)
