"""The Preisach family: operator, inverses, identification, compressive sensing, compression.

Nothing is loaded before it is used: `from vo2_models.preisach import PreisachOperator` loads the operator
and its compiled kernels only.
"""

from importlib import import_module
from typing import Any

_HOME = {
    "Compression": "compression",
    "NonMonotonicInverse": "nonmonotonic_inverse",
    "NonMonotonicPreisach": "nonmonotonic",
    "PreisachFit": "least_squares",
    "PreisachInverse": "inverse",
    "PreisachOperator": "operator",
    "PreisachState": "memory",
    "compress": "compression",
    "fit_nonmonotonic": "nonmonotonic",
    "fit_polynomial": "polynomial",
    "fit_preisach": "least_squares",
    "fit_smooth": "smooth_fit",
    "identify_compressed": "compressive_sensing",
    "identify_preisach_compressed": "compressive_sensing",
    "signed_area_matrix": "signed_area",
}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
