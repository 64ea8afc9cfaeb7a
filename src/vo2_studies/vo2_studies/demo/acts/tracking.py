"""Act 4: both loops follow steps, a sinusoid and a multi-frequency reference on the estimated deflection."""

from __future__ import annotations

from vo2_control.references import REFERENCES

from vo2_studies.demo.acts.loops import COMPOSITE, POLYNOMIAL
from vo2_studies.demo.stage import Phase, Stage

__all__ = ["SIGNALS", "run"]

SIGNALS = ("steps", "sine", "multisine")
_SECONDS_PER_SAMPLE_LIMIT = 0.01
"""Wall time per sample beyond which something hangs [s]."""


def run(stage: Stage) -> None:
    """Track each reference in both loops side by side; simulated time stands still in between."""
    conductor = stage.conductor
    # the composite loop goes on where the random levels ended, the polynomial loop starts cold
    now = {COMPOSITE: stage.phases[-1].end_s, POLYNOMIAL: 1.0}
    for signal in SIGNALS:
        duration = REFERENCES[stage.preset][signal].duration_s
        stage.say(
            f"tracking {signal} for {duration:g} s of simulated time, composite and polynomial side by side"
        )
        until = {space: now[space] + duration for space in now}
        # all is set before time goes on: set in its course, it would take effect at another sample in every run
        for space in now:
            conductor.set(f"{space}/plant", {"run_until_s": now[space]})
            conductor.set(f"{space}/reference", {"signal": signal})
            conductor.set(f"{space}/controller", {"enabled": True})
        for space in now:
            conductor.set(f"{space}/plant", {"run_until_s": until[space]})

        def stand_still(until: dict[str, float] = until) -> bool:
            return all(_stamp(stage, space) >= end - 1e-6 for space, end in until.items())

        conductor.wait_for(
            f"the end of {signal}", stand_still, 30.0 + duration * 1000.0 * _SECONDS_PER_SAMPLE_LIMIT
        )
        for space, end in until.items():
            stage.phases.append(Phase(signal, space, now[space], end))
        now = until
    for space in now:
        conductor.set(f"{space}/controller", {"enabled": False})


def _stamp(stage: Stage, space: str) -> float:
    return float(stage.conductor.value(f"{space.strip('/')}/plant: time", "stamp_s") or "-1")
