"""Records of everything in a model file that belongs to self-sensing alone, and the names of the schemes."""

from __future__ import annotations

from vo2_models.hysteresis.laws import bank_parameters
from vo2_models.parameters import Parameter

__all__ = ["BOUND_KNOTS", "COMPOSITE", "KINDS", "MODE", "PARAMETERS", "SECTION"]

KINDS = ("composite", "combined", "egpi", "preisach", "polynomial", "dynamic")
"""Schemes by name, the default first."""
SECTION = "model.self_sensing"
COMPOSITE = f"{SECTION}.composite"
MODE = f"{SECTION}.mode"
BOUND_KNOTS = f"{SECTION}.bounds.log10_resistance"


def _array(name: str, unit: str, text: str) -> Parameter:
    return Parameter(f"{SECTION}.{name}", [], unit, f"{text}; empty without model", kind="float_array")


_DOMAIN = "lowest and highest log10 of the resistance in ohm that the"

PARAMETERS: tuple[Parameter, ...] = (
    _array("bounds.log10_resistance", "1", "log10 of the resistances in ohm at which error bounds stand"),
    *(
        _array(
            f"bounds.{kind}",
            "m",
            f"error bound of the {kind} scheme: in 95 % of the passes by this resistance the errors stay below",
        )
        for kind in KINDS
    ),
    _array("polynomial.domain", "1", f"{_DOMAIN} polynomial was fitted on"),
    _array(
        "polynomial.coefficients",
        "m",
        "Chebyshev coefficients of the deflection over that domain, lowest first",
    ),
    _array("egpi.domain", "1", f"{_DOMAIN} direct EGPI model was fitted on"),
    Parameter(f"{MODE}.frequency", 0.0, "Hz", "natural frequency of the identified mode; 0 without one", 0.0),
    Parameter(f"{MODE}.damping", 0.0, "1", "damping ratio of the mode", 0.0, 1.0),
    Parameter(
        f"{MODE}.share", 0.0, "1", "part of the deflection that moves through it; 0 without mode", 0.0, 1.0
    ),
    Parameter(f"{MODE}.sample_period", 0.0, "s", "period at which the dynamic scheme is fed", 0.0),
    Parameter(f"{MODE}.note", "", "", "why no mode was identified; empty with one"),
    *bank_parameters(f"{MODE}.deflection", "the deflection under the mode, over the temperature", "m"),
    *bank_parameters(
        f"{COMPOSITE}.resistance", "the composite scheme's own law of -log10 R over the temperature", "1"
    ),
    *bank_parameters(f"{COMPOSITE}.deflection", "its own law of the deflection over the temperature", "m"),
    *bank_parameters(f"{SECTION}.egpi", "the deflection over the scaled -log10 of the resistance", "m"),
    _array("preisach.domain", "1", f"{_DOMAIN} direct Preisach model was fitted on"),
    _array("preisach.walls", "1", "walls of its cells over the scaled -log10 of the resistance"),
    _array("preisach.weights", "m", "weights of the cells of the direct Preisach model, row by row"),
    _array("preisach.coefficients", "m", "Chebyshev coefficients of its memoryless part, lowest first"),
)
