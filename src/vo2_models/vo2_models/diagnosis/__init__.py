"""Compare recordings with a fitted simulation: where they differ, what was left out, how much it gains.

>>> from vo2_models.diagnosis import diagnose  # doctest: +SKIP
>>> diagnose([recording], load_model_parameters("model.yaml")).verdict  # doctest: +SKIP
'agrees'
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from vo2_models.lazy import lazy_names

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
__getattr__, __dir__ = lazy_names(__name__, _HOME)
