"""When an effect is named although moved constants could take it up: none comes near but of its own channel."""

from types import SimpleNamespace

import pytest
from vo2_models.device import preset
from vo2_models.diagnosis.decide import _stands_for_constants
from vo2_models.diagnosis.limits import Limits
from vo2_models.effects import effect


def single(key: str, gain: float) -> SimpleNamespace:
    name, _, signal = key.partition(":")
    return SimpleNamespace(
        keys=(key,), gain=gain, hypotheses=(SimpleNamespace(record=effect(name), signal=signal),)
    )


def stands(device: str, key: str, *others: str) -> bool:
    """Whether an effect of gain 1000 stands for constants beside others of gain 950."""
    nominal = SimpleNamespace(device=device, model=SimpleNamespace(description=preset(device)))
    option = SimpleNamespace(chosen=single(key, 1000.0), final=SimpleNamespace(nominal=nominal))
    singles = [single(other, 950.0) for other in others]
    return _stands_for_constants(option, [option.chosen, *singles], Limits())  # type: ignore[arg-type]


RIG = (
    '{"schema": "vo2-device/1", "id": "rig", "drive": {"channel": "drive_voltage", "unit": "V", "limits": [0, 10]},'
    ' "body": {"kind": "none"}, "responses": {"tip_deflection": {"unit": "m"}}, "sampling": {"period": 0.01}}'
)


@pytest.mark.parametrize(
    ("device", "key", "others", "expected"),
    [
        ("integrated", "thermovoltage", (), True),
        ("integrated", "thermovoltage", ("series_resistance", "adc_saturation:film_resistance"), True),
        ("integrated", "thermovoltage", ("creep",), False),
        ("integrated", "thermovoltage", ("series_resistance", "heater_tcr"), False),
        ("integrated", "heater_tcr", ("nonlinear_heat_loss",), False),
        ("integrated", "sensor_lag:tip_deflection", ("creep", "averaging:tip_deflection"), True),
        (RIG, "sensor_lag:tip_deflection", ("averaging:tip_deflection",), True),
        (RIG, "sensor_lag:tip_deflection", ("creep",), False),
    ],
)
def test_only_effects_of_the_same_channel_alone_may_come_near(device, key, others, expected) -> None:
    assert stands(device, key, *others) is expected
