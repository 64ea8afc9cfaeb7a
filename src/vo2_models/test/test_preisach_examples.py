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
    "preisach.compressive_sensing",
]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(import_module(f"vo2_models.{name}"))
    assert result.attempted > 0 and result.failed == 0
