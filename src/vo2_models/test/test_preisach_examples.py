"""The examples in the docstrings run and give what they say."""

import doctest
from importlib import import_module

import pytest

MODULES = [
    "identification.excitation",
    "hysteresis.preisach",
    "hysteresis.preisach.operator",
    "hysteresis.preisach.signed_area",
    "hysteresis.preisach.inverse",
    "hysteresis.preisach.beam",
    "hysteresis.preisach.compression",
    "hysteresis.preisach.compressive_sensing",
    "hysteresis.preisach.everett_rows",
    "hysteresis.preisach.least_squares",
    "hysteresis.preisach.nonmonotonic",
    "hysteresis.preisach.nonmonotonic_inverse",
    "hysteresis.preisach.polynomial",
    "hysteresis.preisach.smooth_fit",
]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(import_module(f"vo2_models.{name}"))
    assert result.attempted > 0 and result.failed == 0
