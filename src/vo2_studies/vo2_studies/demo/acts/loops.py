"""Act 1: start two loops as separate processes, one per self-sensing scheme, and the recorder."""

from __future__ import annotations

from vo2_models.parameters import Value

from vo2_studies.demo.stage import Stage

__all__ = ["COMPOSITE", "POLYNOMIAL", "RECORDED", "run"]

COMPOSITE = "/vo2"
POLYNOMIAL = "/polynomial"
SIDE_ESTIMATE = f"{COMPOSITE}/polynomial/estimate"
"""The polynomial estimate of the composite loop's resistance: both schemes on the same samples."""

_SAMPLES = ("command", "measurement", "estimate", "reference")
RECORDED = (
    *(f"{space}/{name}" for space in (COMPOSITE, POLYNOMIAL) for name in _SAMPLES),
    SIDE_ESTIMATE,
    "/clock",
)


def run(stage: Stage) -> None:
    """Start everything and wait until it can be called."""
    graph = stage.graph
    common: dict[str, Value] = {"preset": stage.preset}
    stage.say(f"starting the nodes as separate processes (ROS_DOMAIN_ID {graph.domain})")
    recorder = graph.start(
        "record", arguments=["--output", str(stage.bag), "--topics", *RECORDED], namespace=COMPOSITE
    )
    for space, kind in ((COMPOSITE, "composite"), (POLYNOMIAL, "polynomial")):
        # the same device twice: the same seed, so that the two schemes are compared on equal terms
        device = {**common, "seed": stage.seed, "true_channels": True, "clock": space == COMPOSITE}
        graph.start("plant", namespace=space, parameters=device)
        graph.start("estimator", namespace=space, parameters={**common, "kind": kind})
        graph.start("controller", namespace=space, parameters={**common, "enabled": False})
        graph.start("reference", namespace=space, parameters={**common, "signal": "none"})
    graph.start(
        "estimator",
        name="estimator_polynomial",
        parameters={**common, "kind": "polynomial"},
        remap={"estimate": "polynomial/estimate"},
    )
    targets = [f"{space}/{node}" for space in (COMPOSITE, POLYNOMIAL) for node in ("estimator", "controller")]
    graph.start(
        "identifier",
        parameters={
            **common,
            "targets": [*targets, f"{COMPOSITE}/estimator_polynomial"],
            "model_file": str(stage.model_file),
        },
    )
    nodes = [
        f"{space}/{n}"
        for space in (COMPOSITE, POLYNOMIAL)
        for n in ("plant", "estimator", "controller", "reference")
    ]
    stage.conductor.wait_for_nodes([*nodes, f"{COMPOSITE}/estimator_polynomial", f"{COMPOSITE}/identifier"])
    expected = {
        (f"{COMPOSITE}/identifier", f"{COMPOSITE}/command"): 2,
        (f"{COMPOSITE}/estimator_polynomial", SIDE_ESTIMATE): 1,
    }
    for space in (COMPOSITE, POLYNOMIAL):
        # the recorder listens to all; the composite loop has the identifier and the second estimator beside it
        expected[f"{space}/plant", f"{space}/measurement"] = 5 if space == COMPOSITE else 3
        expected[f"{space}/estimator", f"{space}/estimate"] = 2
        expected[f"{space}/reference", f"{space}/reference"] = 2
        expected[f"{space}/controller", f"{space}/command"] = 2
    stage.conductor.wait_for_listeners(expected)
    stage.conductor.wait_for_recorder(recorder, RECORDED)
    stage.say(f"{len(nodes) + 3} processes are on the graph")
