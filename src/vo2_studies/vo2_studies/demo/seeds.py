"""The demo's experiments on many devices, without the graph: mean and spread of every error.

The same library calls as in the nodes, sample by sample the same chain of events; only the messages are
left out, so that ten devices take a minute.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from vo2_control.closed_loop import run_loop
from vo2_control.controller import LinearController
from vo2_control.designs import design_controller
from vo2_control.references import REFERENCES
from vo2_interface.model import operating_point
from vo2_models.device import truth
from vo2_models.device.description import preset
from vo2_models.device.simulation import TRUE_DEFLECTION
from vo2_models.identification.excitation import damped_oscillation, random_levels
from vo2_models.io import write_whole
from vo2_models.recording import RESISTANCE, Recording
from vo2_models.self_sensing import self_sensing
from vo2_models.workflow import fit

from vo2_studies.demo.errors import LEAD_SHARE

__all__ = ["SCHEMES", "device_errors", "run_seeds"]

SCHEMES = ("composite", "polynomial")
_EXPERIMENTS = ("random", "steps", "sine", "multisine")
_LEVEL = 30
_HOLD = 10


def device_errors(device_id: str, seed: int) -> dict[str, dict[str, float]]:
    """Identify one device from a damped oscillation; return scheme -> experiment -> error in % of range."""
    nominal, point = preset(device_id), operating_point(device_id)
    device = truth(device_id, seed=seed)
    share = damped_oscillation(np.linspace(0.0, 1.0, _LEVEL + 1))
    levels = point.cold_a + (point.hot_a - point.cold_a) * share
    excited = device.simulate(np.repeat(levels, _HOLD), seed=seed + 1)
    # what a rig delivers, no more
    names = [*nominal.channels, "commanded_current"]
    model = fit(Recording(excited.time_s, {n: excited[n] for n in names}, device_id), device_id)
    random = np.repeat(random_levels(point.lower_a, point.upper_a, 400, seed=seed), _HOLD)
    played = device.simulate(random, seed=seed + 2)
    # `run_loop` leaves the controller's memory as it is: one design serves all experiments
    controller = design_controller(
        "pi", preset=device_id, sample_period_s=nominal.sample_period, values=model
    )
    if not isinstance(controller, LinearController):
        raise TypeError(
            f"controller: found {type(controller).__name__}, need a linear one to run the loop compiled"
        )
    found: dict[str, dict[str, float]] = {}
    for scheme in SCHEMES:
        sensing = self_sensing(scheme, model)
        estimate, _ = sensing.estimate(played[RESISTANCE])
        errors = {"random": float(np.mean(np.abs(estimate.deflection - played[TRUE_DEFLECTION])))}
        for signal in _EXPERIMENTS[1:]:
            reference = REFERENCES[device_id][signal]
            time = np.arange(round(reference.duration_s / nominal.sample_period)) * nominal.sample_period
            path = [reference.at(t) for t in time]
            result = run_loop(device, sensing, controller, path, seed=seed + 3)
            errors[signal] = float(np.mean(np.abs(result.error_m[round(LEAD_SHARE * time.size) :])))
        found[scheme] = {key: 100.0 * value / point.deflection_range_m for key, value in errors.items()}
    return found


def run_seeds(
    device_id: str, seeds: range, folder: Path, say: Callable[[str], None]
) -> dict[str, dict[str, dict[str, float]]]:
    """Run all devices, print mean and spread, write `seeds.json` after each; return scheme -> experiment -> statistics."""
    rows: list[dict[str, dict[str, float]]] = []
    summary: dict[str, dict[str, dict[str, float]]] = {}
    for seed in seeds:
        rows.append(device_errors(device_id, seed))
        texts = [
            f"{scheme} " + " ".join(f"{rows[-1][scheme][each]:.2f}" for each in _EXPERIMENTS)
            for scheme in SCHEMES
        ]
        say(f"device {seed}: {'; '.join(texts)}")
        summary = _summary(rows)
        # after every device: an interrupt loses nothing
        _save(folder / "seeds.json", {"devices": rows, "summary": summary})
    for scheme, found in summary.items():
        texts = [f"{each} {s['mean']:.2f} ± {s['std']:.2f}" for each, s in found.items()]
        say(f"{scheme}, mean ± s.d. of {len(rows)} devices in % of range: {', '.join(texts)}")
    return summary


def _summary(rows: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, dict[str, float]]]:
    summary: dict[str, dict[str, dict[str, float]]] = {}
    for scheme in SCHEMES:
        summary[scheme] = {}
        for each in _EXPERIMENTS:
            values = np.array([row[scheme][each] for row in rows])
            summary[scheme][each] = {
                "mean": round(float(values.mean()), 4),
                "std": round(float(values.std(ddof=1)) if values.size > 1 else 0.0, 4),
                "largest": round(float(values.max()), 4),
            }
    return summary


def _save(path: Path, content: object) -> None:
    """Replace the file whole, so that an interrupt leaves the one before."""
    write_whole(path, json.dumps(content, indent=2) + "\n")
