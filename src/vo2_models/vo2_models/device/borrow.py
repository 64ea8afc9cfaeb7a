"""Arrays without reference counts inside a compiled loop.

Numba counts references of every array argument of every call, atomically. In a loop that calls a few small
functions with a dozen arrays per sample that is a third of the time. `borrow` gives the same array without an
owner; it must not outlive the array it came from, so it is for the arguments of a kernel, within the kernel.
"""

from __future__ import annotations

from typing import Any

from numba.core import types
from numba.extending import intrinsic

__all__ = ["borrow"]


def _borrow(typingctx: Any, array: Any) -> Any:
    if not isinstance(array, types.Array):
        return None

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        struct = context.make_array(array)(context, builder, arguments[0])
        struct.meminfo = context.get_constant_null(types.MemInfoPointer(array.dtype))
        return struct._getvalue()

    return array(array), codegen


borrow: Any = intrinsic(_borrow)
"""borrow(array): `array` (any dtype and shape) as a view that nobody counts; in compiled code only."""
