"""Compare recordings with a fitted simulation: where they differ, what was left out, how much it gains.

>>> from vo2_models.diagnosis import diagnose  # doctest: +SKIP
>>> diagnose([recording], load_model_parameters("model.yaml")).verdict  # doctest: +SKIP
'agrees'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vo2_models.diagnosis.check import Unusable
    from vo2_models.diagnosis.pipeline import diagnose, study
    from vo2_models.diagnosis.result import Diagnosis, validate
    from vo2_models.diagnosis.stages import Study

__all__ = ["Diagnosis", "Study", "Unusable", "diagnose", "study", "validate"]

_HOME = {
    "Diagnosis": "result",
    "Study": "stages",
    "Unusable": "check",
    "diagnose": "pipeline",
    "study": "pipeline",
    "validate": "result",
}


def __getattr__(name: str) -> Any:
    # the compiler and the simulation load only when something is diagnosed
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
