"""Hysteresis operators, device physics and self-sensing for thermal phase-transition actuators.

What is needed most stands here by name; the rest is in the modules, and both are loaded when they are first touched, so that a
command that only parses its arguments does not wait for the compiler.

>>> import vo2_models as vo2
>>> share = vo2.damped_oscillation([0.0, 0.5, 1.0], reversals_only=True)
>>> recording = vo2.simulate("integrated", 3.68e-3 + 4.81e-3 * share)
>>> recording.device, len(recording)
('integrated', 3)
"""

import os
from typing import Any

from vo2_models.lazy import lazy_names

_HOME = {
    "simulate": "workflow",
    "fit": "workflow",
    "estimate": "workflow",
    "diagnose": "diagnosis",
    "Recording": "recording",
    "load_model_parameters": "model_file",
    "save_model_parameters": "model_file",
    "damped_oscillation": "identification.excitation",
    **dict.fromkeys(
        ("Play", "PlayBank", "CPI", "GPI", "EGPI", "BoucWen", "LimitingLoop", "DomainEnsemble"), "hysteresis"
    ),
    "PreisachOperator": "hysteresis.preisach",
    "NonMonotonicPreisach": "hysteresis.preisach",
    "BoundedPlays": "hysteresis.laws.bounded_plays",
    **dict.fromkeys(
        (
            "SelfSensing",
            "CompositeSelfSensing",
            "CombinedSelfSensing",
            "DirectEGPISelfSensing",
            "DirectPreisachSelfSensing",
            "PolynomialSelfSensing",
            "DynamicSelfSensing",
        ),
        "self_sensing",
    ),
}
"""Public name -> module that it comes from."""
# by `os`, which Python has loaded already: pkgutil loads what reads source code, more than all of this package
_MODULES = [
    entry.name.removesuffix(".py")
    for entry in os.scandir(os.path.dirname(__file__))
    if not entry.name.startswith("_")
    and (entry.name.endswith(".py") or os.path.exists(os.path.join(entry.path, "__init__.py")))
]
__all__ = sorted([*_HOME, *_MODULES])


_load, __dir__ = lazy_names(__name__, {**_HOME, **{name: name for name in _MODULES}, "__version__": ""})


def __getattr__(name: str) -> Any:
    if name == "__version__":
        # takes longer to load than all of this package
        from importlib.metadata import version

        return version(__name__)
    return _load(name)
