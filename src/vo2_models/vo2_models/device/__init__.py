"""The device: driver, thermal core with both transitions, structure, sensors; as truth and as fitted simulation.

Names are loaded on first use, so that importing the package does not load the compiler.

>>> from vo2_models.device import truth
>>> recording = truth("integrated", seed=1).simulate([0.004, 0.005, 0.006], seed=2)
>>> sorted(recording.channels)[:2]
['commanded_current', 'film_resistance']
"""

from importlib import import_module
from typing import Any

_HOME = {
    "PARAMETERS": "model",
    "DeviceModel": "model",
    "PRESETS": "description",
    "DeviceDescription": "description",
    "preset": "description",
    "Simulation": "simulation",
    "Stepper": "stepper",
    "TruthDevice": "ground_truth",
    "temperature_of_surrogate": "surrogate",
    "truth": "ground_truth",
    "surrogate_of_temperature": "surrogate",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name on first use (PEP 562)."""
    if name in _HOME:
        value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
