"""Act 3: random current levels, open loop; both schemes estimate the deflection from the same resistance."""

from __future__ import annotations

from vo2_studies.demo.acts.identification import play
from vo2_studies.demo.acts.loops import SIDE_ESTIMATE
from vo2_studies.demo.stage import Stage

__all__ = ["run"]


def run(stage: Stage) -> None:
    """Play 400 random levels of 10 ms."""
    stage.say("self-sensing on 400 random current levels, open loop")
    play(
        stage,
        "random",
        {
            "excitation.kind": "random_levels",
            "excitation.count": 400,
            "excitation.hold_s": 0.01,
            "excitation.seed": stage.seed,
            "fit": False,
        },
    )
    stage.conductor.wait_for_sample(SIDE_ESTIMATE, stage.phases[-1].end_s)
    # what has done its part would go on to hear every sample of the loop
    done = ("estimator_polynomial", "identifier")
    stage.graph.end(*[each for each in stage.graph.processes if each.name.endswith(done)])
