"""Self-sensing: deflection from resistance, chapter 7. One file per scheme, all behind `SelfSensing`.

>>> from vo2_models.self_sensing import KINDS
>>> "composite" in KINDS and "polynomial" in KINDS
True
"""

from vo2_models.lazy import lazy_names

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
__getattr__, __dir__ = lazy_names(__name__, _HOME)
