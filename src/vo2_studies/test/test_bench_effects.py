"""Every effect still gives the outputs of the stored reference; a difference that matters is seen."""

import math
from copy import deepcopy

import pytest
from vo2_studies.bench.effects import compare, measure, reference


def test_every_effect_gives_the_outputs_of_the_reference():
    stored = reference()
    apart = compare(stored, measure(frozenset(stored)))
    assert apart.cases > 140
    # to the last bit on the machine that wrote it; another one's exponential function may round another way
    assert apart.largest <= 1e-12, f"{apart.where}: {apart.largest:.1e} of its span from the reference"


def test_what_differs_is_found():
    stored = reference()
    case = "integrated device, latent_heat"
    other = deepcopy(stored)
    other[case]["film_resistance"][1] += 1e-8 * other[case]["film_resistance"][0]
    other[case]["digest"] = "changed"
    apart = compare(stored, other)
    assert apart.largest == pytest.approx(1e-8 / math.sqrt(2800), rel=1e-3)
    assert (apart.where, apart.exact) == (f"{case}: film_resistance", apart.cases - 1)
    other[case]["film_resistance"][1] = math.nan
    assert compare(stored, other).largest == math.inf
    assert compare(stored, {}).largest == math.inf
