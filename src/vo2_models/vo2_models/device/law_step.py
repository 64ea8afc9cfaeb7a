"""The step of the law of a transition, chosen when the chain is compiled: a bank of plays, or any law of `hysteresis.laws`.

The chain is compiled once for banks of plays, whose packed vector (n,) it takes as it is, and once more, when first
needed, for any other law. Then the packed law has two dimensions, (1, n), and holds

    [code, m, memory in lower saturation (m), memory in upper saturation (m), the law as its own `move` takes it],

with the place in the registry as code, `ABSENT` for none. Which law is asked is written from the registry: a law that is
registered there can be the law of a device.
"""

from __future__ import annotations

import linecache
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import Law
from vo2_models.hysteresis.laws import FILED
from vo2_models.hysteresis.play_bank import middle_plays, move_plays, of_reversible, reversible_plays

__all__ = ["first_memory", "has_law", "has_reversible", "middle", "move", "pack_law", "reversible"]

Floats = NDArray[np.float64]
HEADER = 2
ABSENT = -1.0
"""Code of a channel without a law."""


def pack_law(law: Law) -> Floats:
    """Return the packed law (1, n).

    Parameters
    ----------
    law : of the registry
    """
    code = float(list(FILED).index(law.name)) if law.present else ABSENT
    parts: list[ArrayLike] = [
        [code, law.memory_size],
        law.initial_memory("lower"),
        law.initial_memory("upper"),
        law.packed,
    ]
    return np.concatenate(parts)[None, :]


def first_memory(packed: Floats) -> Floats:
    """Return the memory of a packed law or bank of plays after a long rest far below every transition.

    Parameters
    ----------
    packed : (1, n) packed law, or (n,) packed bank
    """
    if packed.ndim == 2:
        return packed[0, HEADER : HEADER + int(packed[0, 1])].copy()
    count = int(packed[0])
    state = np.empty(count + 1)
    state[0] = -1e6
    state[1:] = -1.0 + packed[6 + count : 6 + 2 * count]
    return state


def has_reversible(packed: Floats) -> bool:
    """Return whether part of a law has no hysteresis, see `reversible`.

    Parameters
    ----------
    packed : (1, n) packed law, or (n,) packed bank
    """
    return packed.ndim == 1 and bool(packed[of_reversible(int(packed[0]))] > 0.0)


def _written() -> Any:
    """Return the function that asks for the code of each law of the registry in turn."""
    lines = [
        "def move_law(v, packed, memory, make):",
        "    code = packed[0, 0]",
        f"    law = packed[0, {HEADER} + 2 * int(packed[0, 1]):]",
    ]
    for k, name in enumerate(FILED):
        lines += [f"    if code == {k}.0:", f"        return move_{name}(v, law, memory, make)"]
    text, place = "\n".join([*lines, "    return 0.0"]), "<step written from the registry of laws>"
    linecache.cache[place] = (len(text), None, text.splitlines(keepends=True), place)
    names: dict[str, Any] = {f"move_{name}": law.move for name, law in FILED.items()}
    exec(compile(text, place, "exec"), names)
    return numba.njit(error_model="numpy")(names["move_law"])


_move_law = _written()


def _apart_codegen(typingctx: Any, v: Any, packed: Any, memory: Any, make: Any) -> Any:
    """Call `_move_law` without taking it into the caller: all laws at a dozen places double the time to compile."""
    function = typingctx.resolve_value_type(_move_law)
    signature = function.get_call_type(typingctx, (v, packed, memory, make), {})

    def codegen(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        context.add_linking_libs(getattr(context.get_function(function, signature), "libs", ()))
        result = context.get_function(function, signature)(builder, arguments)
        for block in builder.function.blocks:
            for instruction in block.instructions:
                if isinstance(instruction, ir.CallInstr) and "move_law" in str(instruction.callee.name):
                    instruction.attributes.add("noinline")
        return result

    return types.float64(v, packed, memory, make), codegen


_apart: Any = intrinsic(_apart_codegen)


def move(v: float, packed: Floats, memory: Floats, make: bool) -> float:
    """Return the output of a `packed` law at the input v [degC]; the memory moves there if `make`; in compiled code."""
    raise NotImplementedError


def middle(v: float, packed: Floats) -> float:
    """Return the output of a `packed` law half way between its major branches at the input v [degC]; in compiled code."""
    raise NotImplementedError


def reversible(v: float, packed: Floats) -> float:
    """Return what of a `packed` bank of plays has no hysteresis at the input v [degC], of another law 0; in compiled code."""
    raise NotImplementedError


def has_law(packed: Floats) -> bool:
    """Return whether there is a law.

    Parameters
    ----------
    packed : (1, n) packed law, or (n,) packed bank
    """
    return bool(packed[0, 0] >= 0.0 if packed.ndim == 2 else packed[0] > 0.0)


_OPTIONS: Any = {"error_model": "numpy"}


@overload(move, jit_options=_OPTIONS)
def _move(v, packed, memory, make):
    if packed.ndim == 2:
        return lambda v, packed, memory, make: _apart(v, packed, memory, make)
    return lambda v, packed, memory, make: move_plays(v, packed, memory, make)


@overload(middle, jit_options=_OPTIONS)
def _middle(v, packed):
    if packed.ndim == 1:
        return lambda v, packed: middle_plays(v, packed)

    def of_law(v, packed):
        size = int(packed[0, 1])
        lower = packed[0, HEADER : HEADER + size]
        upper = packed[0, HEADER + size : HEADER + 2 * size]
        return 0.5 * (_apart(v, packed, lower, False) + _apart(v, packed, upper, False))

    return of_law


@overload(reversible, jit_options=_OPTIONS)
def _reversible(v, packed):
    if packed.ndim == 2:
        return lambda v, packed: 0.0
    return lambda v, packed: reversible_plays(v, packed)


@overload(has_law, jit_options=_OPTIONS)
def _has_law(packed):
    if packed.ndim == 2:
        return lambda packed: packed[0, 0] >= 0.0
    return lambda packed: packed[0] > 0.0
