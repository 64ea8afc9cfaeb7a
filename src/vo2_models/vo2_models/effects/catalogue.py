"""The catalogue of effects: what the folder holds."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pkgutil import iter_modules

import numpy as np
from numpy.typing import NDArray

from vo2_models.effects.record import Effect

__all__ = ["apply_effects", "effect", "effect_ids", "effects"]

_MACHINERY = ("catalogue", "record")


@cache
def effects() -> Mapping[str, Effect]:
    """Return all effects by id, in alphabetical order."""
    import vo2_models.effects as folder

    found = {}
    for module in sorted(iter_modules(folder.__path__), key=lambda m: m.name):
        if module.name not in _MACHINERY:
            record: Effect = import_module(f"{folder.__name__}.{module.name}").EFFECT
            if record.id != module.name:
                raise ValueError(f"effects/{module.name}.py: found id {record.id!r}, need the file's name")
            found[record.id] = record
    return found


def effect_ids(device: str | None = None) -> tuple[str, ...]:
    """Return the ids of all effects, or of those that can occur on a device."""
    return tuple(key for key, record in effects().items() if device is None or device in record.presets)


def effect(name: str) -> Effect:
    """Return one effect; raise a `ValueError` that lists the known ones."""
    if name not in effects():
        raise ValueError(f"effect: found {name!r}, need one of {', '.join(effects())}")
    return effects()[name]


def apply_effects(
    c: NDArray[np.float64], values: Mapping[str, Mapping[str, float | str]], *, device: str
) -> None:
    """Write effects `{id: {parameter: value, "signal": channel}}` into the coefficient vector `c`.

    An id may be followed by ":" and a word, so that one effect can sit on several signals.

    Raises
    ------
    ValueError : unknown effect or parameter, value out of range, effect that cannot occur on the device.
    """
    for key, given in values.items():
        record = effect(key.split(":")[0])
        if device not in record.presets:
            raise ValueError(
                f"{record.id}: cannot occur on device {device!r}, only on {', '.join(record.presets)}"
            )
        complete, signal = record.complete(given)
        record.apply(c, complete, device, signal)
