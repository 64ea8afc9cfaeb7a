"""Hysteresis operators, device physics and self-sensing for thermal phase-transition actuators.

What is needed most stands here by name; the rest is in the modules, and both are loaded when they are first touched, so that a
command that only parses its arguments does not wait for the compiler.

>>> import vo2_models as vo2
>>> share = vo2.damped_oscillation([0.0, 0.5, 1.0], reversals_only=True)
>>> recording = vo2.simulate("integrated", 3.68e-3 + 4.81e-3 * share)
>>> recording.device, len(recording)
('integrated', 3)
"""

from importlib import import_module
from pkgutil import iter_modules
from typing import Any

_HOME = {
    "simulate": "workflow",
    "fit": "workflow",
    "estimate": "workflow",
    "diagnose": "diagnosis",
    "Recording": "recording",
    "load_model_parameters": "model_file",
    "save_model_parameters": "model_file",
    "damped_oscillation": "identification.excitation",
    "Play": "hysteresis",
    "CPI": "hysteresis",
    "GPI": "hysteresis",
    "EGPI": "hysteresis",
    "PreisachOperator": "hysteresis.preisach",
    "NonMonotonicPreisach": "hysteresis.preisach",
}
"""Public name -> module that it comes from."""
_MODULES = [module.name for module in iter_modules(__path__) if not module.name.startswith("_")]
__all__ = sorted([*_HOME, *_MODULES])


def __getattr__(name: str) -> Any:
    """Load a public name on first use (PEP 562)."""
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name == "__version__":
        # takes longer to load than all of this package
        from importlib.metadata import version

        return version(__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
