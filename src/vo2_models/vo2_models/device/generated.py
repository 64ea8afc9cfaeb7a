"""The stage functions of the compiled chain, generated from the effect files by `device.assembly`.

Names: each hook of `effects.record.HOOKS`, `advance_STAGE`, `settle_STAGE`, `lead`, `lead_of_latent`, `linear_structure`.
The text is `device.assembly.source()`.
"""

from __future__ import annotations

import linecache
from typing import Any

import numba

from vo2_models.device.assembly import source
from vo2_models.effects import effects
from vo2_models.effects.record import PLAIN

KERNEL_SOURCES = tuple(record.file for record in effects().values())
"""Files that are part of every kernel which calls one of these functions."""


_LARGE = ("settle_", "sensor_of", "structure_of", "linear_structure_of", "converter_of")


def _generate() -> dict[str, Any]:
    compiled = numba.njit(error_model="numpy")
    # a call that is not taken into its caller costs as much as what most effects do
    inside = numba.njit(error_model="numpy", forceinline=True)
    names: dict[str, Any] = {
        f"{record.id}__{hook}": compiled(function)
        for record in effects().values()
        for hook, function in record.hooks.items()
        if hook not in (*PLAIN, "delay")
    }
    text, place = source(), "<stage functions generated from the effect files>"
    linecache.cache[place] = (len(text), None, text.splitlines(keepends=True), place)
    written: dict[str, Any] = {}
    exec(compile(text, place, "exec"), names, written)
    for name, function in written.items():
        names[name] = (compiled if name.startswith(_LARGE) else inside)(function)
    return {name: names[name] for name in written}


globals().update(_generate())


def __getattr__(name: str) -> Any:
    raise AttributeError(f"no effect of the catalogue and no hook makes a stage function {name!r}")
