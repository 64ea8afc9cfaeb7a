"""Beyond 8.4: our own H-infinity design with integral action on the composite signal, against a PID of equal margins."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_control.closed_loop import LoopResult
from vo2_control.controller import LinearController
from vo2_models.device import truth
from vo2_models.self_sensing import self_sensing

from vo2_studies.reproduce.claims import Claim, Context, Figure, Section, at_least, at_most
from vo2_studies.reproduce.figures import STYLES, draw
from vo2_studies.reproduce.identified import identify
from vo2_studies.reproduce.own_designs import MAX_SENSITIVITY, Designs, feedforward, own_designs
from vo2_studies.reproduce.peltier import EXPERIMENTS, LIMITS, PERIOD_S, Merit, experiment, merit
from vo2_studies.reproduce.pool import run_many

NUMBER, TITLE = "8.5", "Own robust design against a PID of equal margins, over device draws"

Floats = NDArray[np.float64]

LOOPS = ("PID", "H-infinity alone", "PID + feedforward", "H-infinity", "H-infinity, polynomial")
_RMSE, _LARGEST, _STEADY, _EFFORT = range(4)
_KINDS = {"steps": "steps", "multi": "multi-sine", "noise": "multi-sine with current noise"}


@dataclass(frozen=True)
class Compared:
    """One device under every loop; error and current of the multi-sine with noise every second, of the first only."""

    merits: dict[tuple[str, str], Merit]
    traces: dict[str, tuple[Floats, Floats]]

    def to_json(self) -> dict[str, Any]:
        """As lists."""
        return {
            "merits": [[*key, *astuple(merit)] for key, merit in self.merits.items()],
            "traces": {name: [part.tolist() for part in parts] for name, parts in self.traces.items()},
        }

    @classmethod
    def from_json(cls, found: dict[str, Any]) -> Compared:
        """What `to_json` wrote."""
        return cls(
            {(kind, name): Merit(*values) for kind, name, *values in found["merits"]},
            {
                name: (np.array(error), np.array(current))
                for name, (error, current) in found["traces"].items()
            },
        )


def compare(job: tuple[Designs, int, bool]) -> Compared:
    """Identify one device, run every experiment under every loop."""
    designs, seed, keep = job
    device = truth("peltier", seed=seed)
    _, parameters = identify(device, seed)
    composite, polynomial = (self_sensing(kind, parameters) for kind in ("composite", "polynomial"))
    merits, traces = {}, {}
    for kind in EXPERIMENTS:
        ahead = feedforward(parameters, kind, designs.rate_k_per_s)
        loops = (
            (designs.pid, composite, None),
            (designs.robust_alone, composite, None),
            (designs.pid_ahead, composite, ahead),
            (designs.robust, composite, ahead),
            (designs.robust, polynomial, ahead),
        )
        for name, (law, scheme, plan) in zip(LOOPS, loops, strict=True):
            result: LoopResult = experiment(
                kind, device, scheme, LinearController(law, LIMITS), seed,
                feedforward_a=plan.current_a if plan else None, expected_m=plan.expected_m if plan else None,
            )  # fmt: skip
            merits[kind, name] = merit(kind, result)
            if keep and kind == "noise":
                traces[name] = 1e6 * result.error_m[::8], 1e3 * result.current_a[::8]
    return Compared(merits, traces)


def run(context: Context) -> Section:
    """Return the section's claims; a minute for the designs, then about 2 s per draw and core."""
    designs = own_designs(context.workers, context.progress)
    jobs = [(designs, context.seed + k, k == 0) for k in range(context.draws)]
    found = run_many(
        compare, jobs, context.workers,
        lambda n: context.progress(f"device {n} of {len(jobs)}", 0.2 + 0.8 * n / len(jobs)),
        context.finished(NUMBER, Compared.to_json, Compared.from_json),
    )  # fmt: skip
    table = {
        (kind, name): np.array([astuple(d.merits[kind, name]) for d in found])
        for kind in EXPERIMENTS
        for name in LOOPS
    }
    claims = _required(table)
    for name, peak in designs.peaks.items():
        short = name.lower().replace(" + ", "_").replace(" ", "_")
        claims.append(
            Claim(f"8.5.margins_{short}", "8.5", f"Largest of Ms and Mt of {name} over the identified plants", None, peak, "1",
                  at_most(MAX_SENSITIVITY), "the same limit for every law")
        )  # fmt: skip
    claims += _comparisons(table)
    remarks = (
        *designs.notes,
        "What each design gets: all of them the composite self-sensing and the model identified from the device's own noisy "
        "recording, margins at the same plants, and a choice by the same cost (RMSE under current noise, time constants 20 % "
        "off) on the same design devices, none of which is compared. "
        "The PID alone has no feedforward, H-infinity has: that is a difference of "
        "information, not of synthesis. The lines 'alone' and 'both with feedforward' take it away on either side.",
        "Feedback that fights the crossing of the loop costs effort, so with feedforward the feedback follows what the "
        "feedforward expects, and the temperature is led across the loop at a bounded rate.",
    )
    return Section(NUMBER, TITLE, tuple(claims), _figures(table, found[0].traces), remarks)


def _half(values: Floats) -> float:
    """Half a 95 % confidence interval of the mean."""
    return float(1.96 * values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")


def _required(table: dict[tuple[str, str], Floats]) -> list[Claim]:
    """The required advantage over the PID, by paired ratios per device."""
    ours, words, claims = "H-infinity", "H-infinity + feedforward", []
    count = table["multi", ours].shape[0]
    for kind, needed in (("multi", 15.0), ("noise", 30.0)):
        noise = "with" if kind == "noise" else "without"
        claims.append(_lower("8.5.rmse_" + kind, words, "PID", table, kind, (ours, "PID"), needed))
        effort = table[kind, ours][:, _EFFORT] / table[kind, "PID"][:, _EFFORT]
        claims.append(
            Claim(f"8.5.effort_{kind}", "8.5", f"Control effort of {words} over that of PID, {noise} current noise", None,
                  float(effort.mean()), "1", at_most(1.0),
                  f"s.d. of the current; {count} draws, 95 % confidence +-{_half(effort):.3f}; above 1 on "
                  f"{100 * np.mean(effort > 1):.0f} % of the draws")
        )  # fmt: skip
    growth = 100 * (table["noise", ours][:, _LARGEST] / table["multi", ours][:, _LARGEST] - 1)
    claims.append(
        Claim("8.5.largest", "8.5", f"Growth of the largest error of {words} under current noise", None, float(growth.mean()),
              "%", at_most(5.0), f"{count} draws, 95 % confidence +-{_half(growth):.1f}; 95th percentile "
              f"{np.percentile(growth, 95):.1f}")
    )  # fmt: skip
    claims.append(_lower("8.5.rmse_steps", words, "PID", table, "steps", (ours, "PID"), 15.0))
    return claims


def _comparisons(table: dict[tuple[str, str], Floats]) -> list[Claim]:
    """The same without the difference in information, and the two self-sensing schemes."""
    claims = []
    for kind in EXPERIMENTS:
        claims.append(
            _lower(
                f"8.5.rmse_{kind}_alone",
                "H-infinity alone",
                "PID",
                table,
                kind,
                ("H-infinity alone", "PID"),
                0.0,
            )
        )
        claims.append(
            _lower(f"8.5.rmse_{kind}_both", "H-infinity", "PID, both with feedforward", table, kind,
                   ("H-infinity", "PID + feedforward"), 0.0)
        )  # fmt: skip
    for kind, name in (("noise", "H-infinity alone"), ("noise", "PID + feedforward")):
        effort = table[kind, name][:, _EFFORT] / table[kind, "PID"][:, _EFFORT]
        short = name.lower().replace(" + ", "_").replace(" ", "_")
        claims.append(
            Claim(f"8.5.effort_{short}", "8.5", f"Control effort of {name} over that of PID, with current noise", None,
                  float(effort.mean()), "1", at_most(1.0), f"95 % confidence +-{_half(effort):.3f}")
        )  # fmt: skip
    steady = table["steps", "H-infinity"][:, _STEADY]
    claims.append(
        Claim("8.5.steady", "8.5", "Mean steady-state error of H-infinity + feedforward on the steps", None,
              float(steady.mean()), "um", at_most(0.62),
              f"the published design's 0.62; PID {table['steps', 'PID'][:, _STEADY].mean():.2f}; what remains is the error of "
              "self-sensing")
    )  # fmt: skip
    ratio = table["multi", "H-infinity"][:, _RMSE] / table["multi", "H-infinity, polynomial"][:, _RMSE]
    claims.append(
        Claim("8.5.polynomial", "8.5", "RMSE on the multi-sine of H-infinity + feedforward, composite over polynomial",
              None, float(ratio.mean()), "1", at_most(1.0), f"95 % confidence +-{_half(ratio):.3f}")
    )  # fmt: skip
    return claims


def _lower(
    identity: str, ours: str, theirs: str, table: dict[tuple[str, str], Floats], kind: str,
    names: tuple[str, str], needed: float,
) -> Claim:  # fmt: skip
    """By how much one loop's RMSE lies below another's, per cent."""
    first, second = (table[kind, name][:, _RMSE] for name in names)
    lower = 100 * (1 - first / second)
    return Claim(
        identity, "8.5", f"RMSE of {ours} below that of {theirs}: {_KINDS[kind]}", None, float(lower.mean()), "%",
        at_least(needed),
        f"{first.size} draws, 95 % confidence +-{_half(lower):.1f}; RMSE {first.mean():.2f} against {second.mean():.2f} um",
    )  # fmt: skip


def _figures(
    table: dict[tuple[str, str], Floats], traces: dict[str, tuple[Floats, Floats]]
) -> tuple[Figure, ...]:
    def spread(*axes):
        for axis, (column, label) in zip(
            axes, ((_RMSE, "RMSE [um]"), (_EFFORT, "control effort [mA]")), strict=True
        ):
            values = [table["noise", name][:, column] for name in LOOPS]
            axis.boxplot(values, whis=(5, 95), showfliers=False, medianprops={"color": "#D55E00"})
            axis.set_xticks(
                range(1, len(LOOPS) + 1), [name.replace(" + ", " +\n") for name in LOOPS], fontsize=7
            )
            axis.set_ylabel(label)

    def tracking(top, bottom):
        for name, style in zip(("PID", "H-infinity"), STYLES, strict=False):
            error, current = traces[name]
            time = np.arange(error.size) * 8 * PERIOD_S
            label = name if name == "PID" else "H-infinity + feedforward"
            top.plot(time, error, style, lw=1, label=label)
            bottom.plot(time, current, style, lw=1, label=label)
        top.set_ylabel("error [um]")
        bottom.set_ylabel("current [mA]")
        bottom.set_xlabel("time [s]")

    return (
        draw("Multi-sine with current noise over device draws: quartiles, whiskers from 5 to 95 per cent.", spread,
             rows=2, height=2.5),
        draw("Multi-sine with current noise, first device.", tracking, rows=2, height=2.4),
    )  # fmt: skip
