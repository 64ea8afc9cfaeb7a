"""A parameter as every part of the project sees it: name, unit, meaning, default and range.

The same record declares a ROS parameter, documents a physics term, bounds a fit and labels a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Parameter"]

Value = float | int | bool | str | list[float] | list[str]
Kind = Literal["float", "int", "bool", "string", "float_array", "string_array"]


@dataclass(frozen=True)
class Parameter:
    """One parameter.

    Attributes
    ----------
    name : dotted name, as in a ROS parameter file
    default : value where none is given; arrays as lists
    unit : SI unit text, `1` for a pure number, empty for text
    description : one sentence
    lower, upper : inclusive physical range for numbers (and for each element of an array), None for none
    choices : allowed texts, empty for any
    """

    name: str
    default: Value
    unit: str
    description: str
    lower: float | None = None
    upper: float | None = None
    choices: tuple[str, ...] = ()
    kind: Kind | None = None

    @property
    def type(self) -> Kind:
        """The kind of value, told from the default unless given."""
        if self.kind is not None:
            return self.kind
        if isinstance(self.default, bool):
            return "bool"
        if isinstance(self.default, int):
            return "int"
        if isinstance(self.default, float):
            return "float"
        if isinstance(self.default, str):
            return "string"
        return "string_array" if self.default and isinstance(self.default[0], str) else "float_array"

    def check(self, value: Value) -> Value:
        """Return `value` if it is allowed; raise a `ValueError` naming parameter, finding and range."""
        if self.choices and value not in self.choices:
            raise ValueError(f"{self.name}: found {value!r}, need one of {', '.join(self.choices)}")
        if self.type in ("float", "int", "float_array"):
            for number in value if isinstance(value, list | tuple) else (value,):
                if not isinstance(number, int | float) or number != number or abs(number) == float("inf"):
                    raise ValueError(f"{self.name}: found {number!r}, need a finite number in {self.unit}")
                below = self.lower is not None and number < self.lower
                above = self.upper is not None and number > self.upper
                if below or above:
                    low = "-inf" if self.lower is None else f"{self.lower:g}"
                    high = "inf" if self.upper is None else f"{self.upper:g}"
                    raise ValueError(f"{self.name}: found {number:g}, need {low} to {high} {self.unit}")
        return value
