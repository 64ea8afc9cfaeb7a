"""Act 2: excite with a damped oscillation, fit, hand the model to estimators and controllers."""

from __future__ import annotations

from vo2_studies.demo.stage import Phase, Stage

__all__ = ["play", "run"]

_STATUS = "vo2/identifier: progress"


def run(stage: Stage) -> None:
    """Identify the device through the running graph."""
    stage.say("identifying from a damped oscillation of the current")
    play(stage, "identification", {"excitation.kind": "damped_oscillation", "fit": True})
    stage.say(f"model fitted and published; saved in {stage.model_file.name}")


def play(stage: Stage, phase: str, parameters: dict[str, object], timeout_s: float = 180.0) -> None:
    """Let the identifier play an excitation, and note the phase."""
    conductor = stage.conductor
    conductor.set("/vo2/identifier", parameters)  # type: ignore[arg-type]
    conductor.statuses.pop(_STATUS, None)
    conductor.trigger("/vo2/identifier/start")
    conductor.wait_for(
        f"the identifier to end {phase}",
        lambda: conductor.value(_STATUS, "state") in ("done", "failed", "cancelled"),
        timeout_s,
    )
    if conductor.value(_STATUS, "state") != "done":
        raise RuntimeError(f"{phase}: {conductor.statuses[_STATUS][1]}")
    stage.phases.append(
        Phase(
            phase,
            "/vo2",
            float(conductor.value(_STATUS, "first_stamp_s")),
            float(conductor.value(_STATUS, "last_stamp_s")),
        )
    )
