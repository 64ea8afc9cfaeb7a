"""Timing that a busy machine disturbs little: interleaved pairs, medians, and plain C compiled on the spot."""

from __future__ import annotations

import ctypes
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["aligned", "alternate", "compiled_c", "per_call", "pointer"]

FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")
"""What the yardstick is compiled with."""


@contextmanager
def compiled_c(source: str) -> Iterator[ctypes.CDLL]:
    """Compile C source with gcc -O3 -march=native and yield the loaded library; it vanishes afterwards.

    Raises
    ------
    RuntimeError : no gcc, or it refuses the source.
    """
    compiler = shutil.which("gcc")
    if compiler is None:
        raise RuntimeError("gcc: not found on the path, need it for the yardstick; install a C compiler")
    with tempfile.TemporaryDirectory() as folder:
        code, library = Path(folder, "yardstick.c"), Path(folder, "yardstick.so")
        code.write_text(source, encoding="utf-8")
        command = [compiler, *FLAGS, str(code), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"gcc: refused the yardstick: {done.stderr.strip()}")
        yield ctypes.CDLL(str(library))


def pointer(array: NDArray[np.float64]) -> ctypes.c_void_p:
    """Address of a contiguous array, for a C function."""
    return ctypes.c_void_p(array.ctypes.data)


def aligned(values: ArrayLike) -> NDArray[np.float64]:
    """A float64 copy that starts on a cache line; a yardstick on unaligned arrays runs several times slower."""
    array = np.asarray(values, dtype=np.float64)
    room = np.empty(array.size + 8)
    offset = -room.ctypes.data // 8 % 8
    copy = room[offset : offset + array.size].reshape(array.shape)
    copy[...] = array
    return copy


def alternate(*candidates: Callable[[], object], repeats: int = 15) -> tuple[float, ...]:
    """Return the median seconds of each candidate, run in turn so that all meet the same disturbances.

    Each runs once unmeasured before.
    """
    for candidate in candidates:
        candidate()
    seconds: list[list[float]] = [[] for _ in candidates]
    for _ in range(repeats):
        for candidate, into in zip(candidates, seconds, strict=True):
            start = perf_counter()
            candidate()
            into.append(perf_counter() - start)
    return tuple(statistics.median(into) for into in seconds)


def per_call(function: Callable[[float], object], values: list[float], *, repeats: int = 15) -> float:
    """Median seconds of one call from Python, over repeated passes through the values."""

    def through() -> None:
        for value in values:
            function(value)

    (seconds,) = alternate(through, repeats=repeats)
    return seconds / len(values)
