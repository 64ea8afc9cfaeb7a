"""Self-sensing: deflection from resistance, chapter 7. One file per scheme, all behind `SelfSensing`.

>>> from vo2_models.self_sensing import KINDS
>>> "composite" in KINDS and "polynomial" in KINDS
True
"""

from importlib import import_module
from typing import Any

_HOME = {
    "KINDS": "records",
    "PARAMETERS": "records",
    "Estimate": "scheme",
    "SelfSensing": "scheme",
    "self_sensing": "scheme",
    "CompositeSelfSensing": "composite",
    "CombinedSelfSensing": "combined",
    "DirectEGPISelfSensing": "direct_egpi",
    "DirectPreisachSelfSensing": "direct_preisach",
    "PolynomialSelfSensing": "polynomial",
    "DynamicSelfSensing": "dynamic",
    "characterise": "characterisation",
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
