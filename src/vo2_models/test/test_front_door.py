"""What `import vo2_models as vo2` offers: every name is there, and nothing heavy loads before it is used."""

import subprocess
import sys
import warnings
from pkgutil import iter_modules
from types import ModuleType

import numpy as np
import pytest
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording

import vo2_models as vo2


@pytest.mark.parametrize("name", vo2.__all__)
def test_every_name_is_there(name):
    assert getattr(vo2, name) is not None


def test_importing_loads_neither_arrays_nor_the_compiler():
    heavy = ("numpy", "scipy", "numba", "yaml", "importlib.metadata", "pkgutil", "inspect", "ast", "tokenize")
    code = f"import sys, vo2_models; print([name for name in {heavy} if name in sys.modules])"
    # without site, whose path files load what they like
    code = f"import sys; sys.path[:] = {sys.path!r}; {code}"
    found = subprocess.run([sys.executable, "-S", "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_every_law_and_every_scheme_is_there_by_name():
    offered = {getattr(vo2, name) for name in vo2.__all__}
    assert set(vo2.hysteresis.LAWS.values()) <= offered
    schemes = [name for name in vo2.self_sensing.__all__ if name.endswith("SelfSensing")]
    assert len(schemes) > 5 and {getattr(vo2.self_sensing, name) for name in schemes} <= offered


def test_the_modules_are_those_that_can_be_imported():
    modules = {m.name for m in iter_modules(vo2.__path__) if not m.name.startswith("_")}
    assert {name for name in vo2.__all__ if isinstance(getattr(vo2, name), ModuleType)} == modules


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        vo2.nothing  # noqa: B018


def test_simulate_fit_estimate_diagnose():
    """A device is fitted, its deflection is estimated from another recording, and it is found unchanged."""
    share = vo2.damped_oscillation(np.linspace(0.0, 1.0, 13))
    current = np.repeat(3.68e-3 + 4.81e-3 * share, 10)
    model = vo2.fit(vo2.simulate("integrated", current, seed=1), "integrated")
    again = vo2.simulate("integrated", current, seed=2)
    found = vo2.estimate(model, again[RESISTANCE])
    assert np.mean(np.abs(found.deflection - again[TIP_DEFLECTION])) < 0.02 * 57.03e-6
    assert vo2.diagnose([again], model).verdict == "agrees"
    heated = vo2.simulate("integrated", current, seed=2, effects={"series_resistance": {"resistance": 5e3}})
    assert np.all(heated[RESISTANCE] > again[RESISTANCE])
    fitted = vo2.simulate(model, current, noise=False)
    assert np.mean(np.abs(np.log10(fitted[RESISTANCE] / again[RESISTANCE]))) < 0.02


def test_what_a_calibration_did_not_allow_is_told():
    share = vo2.damped_oscillation(np.linspace(0.0, 1.0, 11))
    whole = vo2.simulate("integrated", np.repeat(3.68e-3 + 4.81e-3 * share, 12), seed=1)
    film = Recording(whole.time_s, {k: whole[k] for k in ("commanded_current", RESISTANCE)}, "integrated")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        vo2.fit(film, "integrated")
    assert any("the model has no deflection" in str(one.message) for one in told)
