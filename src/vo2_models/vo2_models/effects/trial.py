"""A trial of an effect's functions in plain Python: what they return, and that an effect that is off changes nothing."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from vo2_models.effects.record import HOOKS, Effect

__all__ = ["try_functions"]

_TRIED: Mapping[str, float] = {
    "current": 5e-3, "previous": 5e-3, "time": 1.0, "period": 1e-3, "h": 1e-4, "sample": 10, "joule": 25.0, "drive": 25.0,
    "rise": 25.0, "surplus": 1.0, "resistance": 1e4, "fraction": 0.5, "film": 60.0, "share": 0.5, "equilibrium": 0.5,
    "before": 0.5, "output": 0.5, "half_way": 1.0, "middle": 0.1, "value": 1e4, "deflection": 1e-5, "course": 0.0,
    "time_constant_of_body": 1.8e-3, "time_constant_between": 1.8e-3, "ambient_of_device": 22.0, "on_stage": 0.0,
}  # fmt: skip
"""Quantities of the stages and constants of the device with which functions are tried: a device of milliseconds at rest."""
_SAME = {
    "drive": "current", "terminals": "value", "structure": "deflection", "sensor": "value", "converter": "value",
    "follow": "equilibrium",
}  # fmt: skip
"""Hook -> quantity that it gives back while the effect is off; the others then give 0, a factor 1."""
_FACTORS = ("lag",)
_SEVERAL = {"loss": 2, "body": 2}
"""Hook -> how many numbers it gives where that is not one."""
_ROUNDING = 1e-12
_NUMBER = (int, float, np.number, np.bool_)


def try_functions(record: Effect) -> None:
    """Run settled, advance and every hook at magnitudes of `typical`, and every hook at the neutral values.

    Parameters
    ----------
    record : with its functions, whose arguments are known ones

    Raises
    ------
    ValueError : a function that cannot be run or does not give the numbers that it has to give, a number that is not finite,
        or a hook that changes something while every parameter is neutral; one line with file and function.
    """
    hooks = [name for name in record.hooks if name in HOOKS]
    for ranges in record.typical.values():
        given = _at_rest(record, {name: low for name, (low, _) in ranges.items()})
        _check_finite(record, "prepare", [given[name] for name in record.derived])
        _check_finite(record, "settled", given["memory"])
        if "advance" in record.hooks:
            moved = _named(
                record, "advance", given, [state.name for state in record.states if state.size == 1]
            )
            _check_finite(record, "advance", [*moved.values(), *given["memory"]])
            given |= moved
        for name in hooks:
            _check_finite(record, name, _numbers(record, name, given))
    given = _at_rest(record, {})
    for name in hooks:
        same = given[_SAME[name]] if name in _SAME else float(name in _FACTORS)
        for one in _numbers(record, name, given):
            # an effect that is off is not run, so that its hook need not be defined there
            if math.isfinite(one) and abs(one - same) > _ROUNDING * abs(same):
                raise ValueError(
                    f"{_place(record, name)}: found {one:g} of {same:g} with neutral parameters, need {same:g}: an effect that "
                    "is off changes nothing"
                )


def _at_rest(record: Effect, values: Mapping[str, float]) -> dict[str, Any]:
    """Argument -> value for an effect's functions; its states as they are after a long rest."""
    own = {**record.neutral(), **values}
    given: dict[str, Any] = {**_TRIED, **own, **dict.fromkeys(record.derived, math.nan)}
    given |= {s.name: math.nan if s.settled is None else s.settled for s in record.states}
    if record.derived:
        asked = {**given, "values": own, "time_constant": _TRIED["time_constant_of_body"]}
        given |= _named(record, "prepare", asked, record.derived)
    if "settled" in record.hooks:
        given |= _named(record, "settled", given, [state.name for state in record.states])
    memory: list[float] = []
    for state in record.states:
        place = len(memory)
        memory += np.resize(given[state.name], state.size).tolist()
        if state.size > 1:
            given[state.name] = place
    return given | {"memory": np.array(memory)}


def _named(record: Effect, name: str, given: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return name -> number, of those that a function gives for these names; none where it is not defined."""
    need = f"{len(names)} number{'s' * (len(names) > 1)}: {', '.join(names)}"
    return dict(zip(names, _call(record, name, given, len(names), need), strict=False))


def _numbers(record: Effect, name: str, given: Mapping[str, Any]) -> tuple[Any, ...]:
    return _call(record, name, given, _SEVERAL.get(name, 1), HOOKS[name].gives)


def _call(record: Effect, name: str, given: Mapping[str, Any], count: int, need: str) -> tuple[Any, ...]:
    """Return the numbers that a function gives, as many as `count`; none where it is not defined."""
    function = record.hooks[name]
    try:
        with np.errstate(all="ignore"):
            found = function(*(given[argument] for argument in inspect.signature(function).parameters))
    except (ArithmeticError, ValueError):
        return ()
    except Exception as error:
        raise ValueError(
            f"{_place(record, name)}: cannot be run ({type(error).__name__}: {error}); need plain arithmetic on its arguments"
        ) from error
    if not count:
        return ()  # all its states are rows of the memory
    numbers = tuple(found) if isinstance(found, tuple) or name == "prepare" else (found,)
    several = name == "settled" and any(state.size > 1 for state in record.states)
    kinds = (*_NUMBER, np.ndarray) if several else _NUMBER
    if len(numbers) != count or not all(isinstance(one, kinds) for one in numbers):
        raise ValueError(f"{_place(record, name)}: found {found!r}, need {need}")
    return numbers


def _check_finite(record: Effect, name: str, numbers: Iterable[float]) -> None:
    for one in numbers:
        if not math.isfinite(one):
            raise ValueError(
                f"{_place(record, name)}: found {one} at magnitudes of typical, need finite numbers"
            )


def _place(record: Effect, name: str) -> str:
    return f"{record.file or f'effect {record.id}'}: hook {name}"
