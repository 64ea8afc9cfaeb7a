"""The hysteresis laws by name, and the law of a section of a model file.

To add a law, add a file to this folder with `EXAMPLE`, one such law over a temperature in degC, with the output -log10 R: model
files, nodes and devices know its class from then on, and the tests of the protocol run on the example. With `FIT`,
which returns a law of inputs (n,), outputs (n,), the part that each sample is held out with (n,) and whether it is measured (n,),
`fit --law` knows it too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import numpy as np

from vo2_models.hysteresis.bouc_wen import BoucWen
from vo2_models.hysteresis.domains import DomainEnsemble
from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.limiting_loop import LimitingLoop
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.hysteresis.prandtl_ishlinskii import CPI, EGPI, GPI
from vo2_models.hysteresis.preisach.nonmonotonic import NonMonotonicPreisach
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.parameters import Parameter, Value

__all__ = [
    "ADDED",
    "FILED",
    "FITS",
    "LAWS",
    "bank_parameters",
    "law_from_parameters",
    "law_parameters",
    "scaled_law",
]


def _added() -> dict[str, Law]:
    found: dict[str, Law] = {}
    for name in sorted(module.name for module in iter_modules(__path__)):
        module = import_module(f"{__name__}.{name}")
        example = getattr(module, "EXAMPLE", None)
        if not isinstance(example, Law):
            raise ValueError(
                f"{module.__file__}: found EXAMPLE = {example!r}, need one law of the class that it defines"
            )
        if example.name in found:
            raise ValueError(f"{module.__file__}: found the name {example.name} twice, need another")
        found[example.name] = example
    return found


ADDED: Mapping[str, Law] = _added()
"""Name -> example of the law of each file in this folder."""
FITS: Mapping[str, Callable[..., Law]] = {
    name: module.FIT
    for name, law in ADDED.items()
    if hasattr(module := import_module(type(law).__module__), "FIT")
}
"""Name -> fit of the law of each file in this folder that has one."""
KERNEL_SOURCES = tuple(str(import_module(type(law).__module__).__file__) for law in ADDED.values())
"""Files that are part of every kernel in which any law may run."""
_OWN: tuple[type[Law], ...] = (
    PlayBank,
    PreisachOperator,
    NonMonotonicPreisach,
    BoucWen,
    LimitingLoop,
    DomainEnsemble,
)
FILED: Mapping[str, type[Law]] = {law.name: law for law in (*_OWN, *(type(law) for law in ADDED.values()))}
"""Name in a model file -> class. GPI and EGPI are written as the bank of plays that they are."""

LAWS: Mapping[str, type[Law]] = {**FILED, CPI.name: CPI, GPI.name: GPI, EGPI.name: EGPI}
"""Name -> class of every law."""


def law_from_parameters(section: str, values: Mapping[str, Value]) -> Law:
    """Return the law that `Law.to_parameters` wrote; without `section.law` it is a bank of plays.

    Parameters
    ----------
    section : such as `model.resistance`
    values : name -> value of the model file

    Raises
    ------
    ValueError : a law that does not exist, or a parameter that is missing or not allowed; the message names it.
    """
    name = str(values.get(f"{section}.law") or PlayBank.name)
    if name not in FILED:
        raise ValueError(f"{section}.law: found {name!r}, need one of {', '.join(FILED)}")
    return FILED[name].from_parameters(section, values)


def scaled_law(law: Law, gain: float, zero: float) -> Law:
    """Return the law whose output is gain times that of `law`, plus `zero`.

    The parameters whose unit in `described` begins with that of the output take the gain, `polynomial` or `bias` the zero.

    Parameters
    ----------
    law : of a model file
    gain : factor [1]
    zero : [output unit]

    Raises
    ------
    ValueError : a law that no model file holds, or one with no constant part to take `zero`.
    """
    if gain == 1.0 and zero == 0.0:
        return law
    if type(law) not in FILED.values():
        raise ValueError(f"law: found {law.name!r}, need one of {', '.join(FILED)} to be scaled")
    if isinstance(law, NonMonotonicPreisach):
        operator: Any = scaled_law(law.operator, gain, zero)
        return replace(law, operator=operator, k0=gain * law.k0, k1=gain * law.k1)
    changes: dict[str, Any] = {
        name: np.array(gain * np.asarray(getattr(law, name), dtype=np.float64))
        for name, (unit, _) in law.described.items()
        if unit.startswith("{y}")
    }
    constant = next((name for name in ("polynomial", "bias") if name in changes), None)
    if constant is not None:
        coefficients = changes[constant] if changes[constant].size else np.zeros(1)
        coefficients.flat[0] += zero
        changes[constant] = coefficients
    elif zero != 0.0:
        raise ValueError(
            f"law: found {law.name!r} without polynomial or bias, need one of them to move its output"
        )
    return replace(law, **{name: value if value.ndim else float(value) for name, value in changes.items()})  # type: ignore[type-var]


def law_parameters(section: str, what: str, unit: str) -> tuple[Parameter, ...]:
    """Return the `Parameter` records of any law over a temperature, for the declaration by a node.

    Parameters
    ----------
    section : such as `model.resistance`
    what : the output, for the descriptions
    unit : of the output
    """
    choice = Parameter(
        f"{section}.law", "", "", f"hysteresis law of {what}; empty for {PlayBank.name}", choices=("", *FILED)
    )
    return choice, *_records(section, what, unit, tuple(FILED.values()))


def bank_parameters(section: str, what: str, unit: str) -> tuple[Parameter, ...]:
    """Return the `Parameter` records of a bank of plays over a temperature: `section`, `what`, `unit` as there."""
    return _records(section, what, unit, (PlayBank,))


def _records(section: str, what: str, unit: str, laws: tuple[type[Law], ...]) -> tuple[Parameter, ...]:
    described = {name: text for law in laws for name, text in law.described.items()}
    return tuple(
        Parameter(
            f"{section}.{name}",
            [],
            symbol.format(y=unit, u="K"),
            f"{text} of {what}; empty without",
            kind="float_array",
        )
        for name, (symbol, text) in described.items()
    )
