"""What of the commands reaches a driven device: the safe current is that of the device file."""

import math
from importlib.resources import files

import pytest
from vo2_interface.command_gate import CommandGate
from vo2_interface.lockstep import HOLD_SAMPLES
from vo2_interface.model import operating_point

PERIOD_NS = 10_000_000


class Told:
    """Diagnostics that keep what they are told."""

    def __init__(self):
        self.texts = []

    def report(self, name, level, text, **_):
        self.texts.append(text)

    def count(self, name, text):
        self.texts.append(text)


@pytest.fixture(params=[0.0, 2.0e-3], ids=["0 A", "2 mA"])
def point(request, tmp_path):
    shipped = (files("vo2_models.device") / "files" / "integrated.yaml").read_text()
    assert shipped.count("safe: 0.0") == 1
    device = tmp_path / "warm.yaml"
    device.write_text(
        shipped.replace("safe: 0.0", f"safe: {request.param}").replace("id: integrated", "id: warm")
    )
    found = operating_point(str(device))
    assert found.safe_a == request.param
    return found


def test_without_a_command_the_safe_current_of_the_device_flows(point):
    told = Told()
    gate = CommandGate(point, PERIOD_NS, told)
    assert gate.next_period() == point.safe_a
    assert gate.take(PERIOD_NS, 5e-3, math.nan, PERIOD_NS) == 5e-3
    flows = [gate.next_period() for _ in range(HOLD_SAMPLES + 2)]
    assert flows == [5e-3] * (HOLD_SAMPLES + 1) + [point.safe_a]
    assert told.texts[-1].endswith(f"safe current {point.safe_a:g} A")


@pytest.mark.parametrize("late", range(HOLD_SAMPLES + 1))
def test_a_late_command_is_held_no_longer_than_one_in_time(point, late):
    gate = CommandGate(point, PERIOD_NS, Told())
    assert gate.take(PERIOD_NS, 5e-3, math.nan, (1 + late) * PERIOD_NS) == 5e-3
    flows = [gate.next_period() for _ in range(HOLD_SAMPLES + 2)]
    assert flows.count(5e-3) == HOLD_SAMPLES + 1 - late and flows[-1] == point.safe_a


def test_a_command_that_is_not_finite_is_the_safe_current_and_one_too_large_the_limit(point):
    gate = CommandGate(point, PERIOD_NS, Told())
    assert gate.borne(math.nan, 0) == point.safe_a
    assert gate.borne(1.0, 0) == point.most_a
