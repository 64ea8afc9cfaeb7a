"""A resistance sensor that sticks under a closed loop: safe current within three samples, the reason, a calm return."""

import itertools

import pytest
from vo2_control.controller_node import ControllerNode
from vo2_estimation.estimator_node import EstimatorNode
from vo2_interface.model import operating_point
from vo2_interface.testing import bench
from vo2_models.device import truth

MS = 1_000_000
REFERENCE_M = 30e-6
STUCK = range(60, 90)
SAMPLES = 160
POINT = operating_point("integrated")


def run(rig, device, *, stuck=range(0)):
    """Close the loop over estimator and controller; return the command that answers each sample."""
    commands, current, held = [], 0.0, None
    for k in range(SAMPLES):
        sample = dict(zip(("heater_current", "film_resistance"), device.step(current), strict=False))
        held = sample["film_resistance"] if k not in stuck else held
        rig.say("/vo2/measurement", k * MS, {**sample, "film_resistance": held})
        rig.say("/vo2/reference", k * MS, {"tip_deflection": REFERENCE_M})
        rig.until(lambda k=k: any(stamp == k * MS for stamp, _ in rig.heard["/vo2/command"][-3:]))
        current = rig.heard["/vo2/command"][-1][1][0]
        commands.append(current)
    return commands


@pytest.mark.parametrize("stuck", [range(0), STUCK])
def test_a_stuck_sensor_leads_to_the_safe_current_and_a_return_without_a_bump(model_file, stuck):
    with bench(["--ros-args", "--params-file", str(model_file)]) as rig:
        rig.hear("/vo2/command", ("heater_current",))
        rig.hear("/vo2/estimate", ("tip_deflection",))
        rig.add(EstimatorNode)
        rig.add(ControllerNode)
        commands = run(rig, truth("integrated", seed=1).stepper(seed=9), stuck=stuck)
        estimates = [values[0] for _, values in rig.heard["/vo2/estimate"]]
        detected = next((k for k, value in enumerate(estimates) if value != value), None)
        texts = [
            text for name, text, _ in rig.statuses if name.endswith(("estimator: input", "controller: input"))
        ]
    if not stuck:
        assert detected is None
        assert min(commands[5:]) >= POINT.lower_a
        return
    # the eighth repeat is the first that proves something
    assert detected is not None
    assert stuck[0] + 7 <= detected <= stuck[0] + 11
    # held for three samples, then let go
    assert commands[detected : detected + 3] == [commands[detected - 1]] * 3
    assert set(commands[detected + 3 : stuck[-1] + 1]) == {0.0}
    assert any("stuck or saturated at" in text for text in texts)
    assert any("safe current 0 A" in text for text in texts)
    # it starts again from the coldest operating current, and no step is larger than the start of the loop made
    back = commands[stuck[-1] + 1 :]
    assert back[0] == pytest.approx(POINT.lower_a, abs=1e-6)
    first = [abs(b - a) for a, b in itertools.pairwise(commands[:50])][1:]
    assert max(abs(b - a) for a, b in itertools.pairwise(back)) <= 1.5 * max(first)
    assert abs(commands[-1] - commands[stuck[0] - 1]) < 0.1 * (POINT.upper_a - POINT.lower_a)
