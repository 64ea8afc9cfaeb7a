"""The examples in the docstrings run and give what they say."""

import doctest
from importlib import import_module

import pytest

MODULES = [
    "excitation",
    "preisach",
    "preisach.operator",
    "preisach.signed_area",
    "preisach.inverse",
    "preisach.beam",
    "preisach.compression",
    "preisach.compressive_sensing",
    "preisach.everett_rows",
    "preisach.least_squares",
    "preisach.memory",
    "preisach.nonmonotonic",
    "preisach.nonmonotonic_inverse",
    "preisach.polynomial",
    "preisach.smooth_fit",
]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(import_module(f"vo2_models.{name}"))
    assert result.attempted > 0 and result.failed == 0
