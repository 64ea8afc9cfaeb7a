"""When an effect is named although moved constants could take it up, on a device without body: no other sensor's comes near."""

from types import SimpleNamespace

import pytest
from vo2_models.diagnosis.decide import _stands_for_constants
from vo2_models.diagnosis.limits import Limits
from vo2_models.effects import effect


def single(key: str, gain: float) -> SimpleNamespace:
    name, _, signal = key.partition(":")
    return SimpleNamespace(
        keys=(key,), gain=gain, hypotheses=(SimpleNamespace(record=effect(name), signal=signal),)
    )


def stands(key: str, *others: str) -> bool:
    """Whether an effect of gain 1000 stands for constants beside others of gain 950."""
    option = SimpleNamespace(chosen=single(key, 1000.0))
    singles = [single(other, 950.0) for other in others]
    return _stands_for_constants(option, [option.chosen, *singles], Limits())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("key", "others", "expected"),
    [
        ("sensor_lag:tip_deflection", (), True),
        ("sensor_lag:tip_deflection", ("averaging:tip_deflection",), True),
        ("sensor_lag:tip_deflection", ("creep",), False),
    ],
)
def test_only_effects_of_the_same_sensor_may_come_near(key, others, expected) -> None:
    assert stands(key, *others) is expected
