"""Compiled kernels whose cache is never stale.

Numba's own cache notices a change of the file that a kernel stands in. But the compiled code contains what the kernel
calls, and constants, from other files too. Here the place of the cache is named by a digest of that file, of all
files of the same project that it imports, directly or not, of the files that a module of these names as its
`KERNEL_SOURCES`, and of the versions of numba and numpy: what was compiled from other sources is simply not found.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy

from vo2_models.numerics.interrupts import raise_again

_UNWANTED = "coverage"
"""Numba loads it wherever it is installed, a tenth of a second of every node's start, and uses it in coverage runs alone."""
if _absent := _UNWANTED not in sys.modules:
    sys.modules[_UNWANTED] = None  # type: ignore[assignment]
import numba  # noqa: E402
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator  # noqa: E402

if _absent:
    del sys.modules[_UNWANTED]

__all__ = ["cache_folder", "kernel", "source_digest"]

UNUSED_S = 90 * 86400.0
"""Age [s] from which a folder of kernels that nobody has loaded is removed."""


def cache_folder() -> Path:
    """Folder of all compiled kernels: `VO2_KERNEL_CACHE`, else `vo2-kernels` in the user's cache folder.

    Returns
    -------
    Path : which need not exist
    """
    given = os.environ.get("VO2_KERNEL_CACHE")
    if given:
        return Path(given)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "vo2-kernels"


raise_again()  # compiling takes seconds to minutes, most of all that somebody may want to end

_IMPORT = re.compile(
    rb"^[ \t]*(?:from +(vo2_[\w.]+) +import +(\([^)]*\)|[^\n]*)|import +(vo2_[\w.]+))", re.MULTILINE
)


@cache
def _imports(path: str) -> tuple[str, ...]:
    """Files of this project that a file imports, by reading it."""
    found: list[Path] = []
    for module, names, plain in _IMPORT.findall(Path(path).read_bytes()):
        name = (module or plain).decode()
        below = re.findall(r"\w+", names.decode())
        for dotted in (name, *(f"{name}.{each}" for each in below)):
            top, *rest = dotted.split(".")
            package = sys.modules.get(top)
            if package is not None and package.__file__:
                place = Path(package.__file__).parent.joinpath(*rest)
                found += [place / "__init__.py", place.parent / f"{place.name}.py"]
    return tuple(dict.fromkeys(str(file) for file in found if file.is_file()))


@cache
def source_digest(*paths: str) -> str:
    """Digest of files, of everything of this project that they import, and of the versions of numba and numpy.

    Parameters
    ----------
    paths : files

    Returns
    -------
    str : hexadecimal
    """
    seen: set[str] = set()
    todo = list(paths)
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            todo += _imports(path)
    total = hashlib.sha256(f"numba {numba.__version__} numpy {numpy.__version__}".encode())
    for module in list(sys.modules.values()):
        if getattr(module, "__file__", None) in seen:
            seen.update(getattr(module, "KERNEL_SOURCES", ()))
    # by content, not by place: the same sources in another folder make the same code
    for content in sorted(Path(path).read_bytes() for path in seen):
        total.update(hashlib.sha256(content).digest())
    return total.hexdigest()[:24]


class _Locator(_CacheLocator):
    """A folder for each digest; numba asks for a stamp as well, which is the digest again."""

    def __init__(self, name: str, digest: str, line: int) -> None:
        self.folder, self.digest, self.line = cache_folder() / f"{name}-{digest}", digest, line

    def get_cache_path(self) -> str:
        return str(self.folder)

    def get_source_stamp(self) -> str:
        return self.digest

    def get_disambiguator(self) -> str:
        return str(self.line)

    def ensure_cache_path(self) -> None:
        if not self.folder.exists():
            _remove_unused(self.folder.parent)
        super().ensure_cache_path()


def _remove_unused(folder: Path) -> None:
    """Remove folders of kernels that have not been written to for long."""
    for old in folder.glob("*-*") if folder.is_dir() else ():
        if time.time() - old.stat().st_mtime > UNUSED_S:
            shutil.rmtree(old, ignore_errors=True)  # another process may have removed it


class _Storage(CompileResultCacheImpl):
    def __init__(self, function: Callable[..., Any], locator: _Locator) -> None:
        self._lineno = function.__code__.co_firstlineno
        self._locator = locator
        self._filename_base = self.get_filename_base(function.__qualname__, sys.abiflags)


class _KernelCache(FunctionCache):
    """Numba's cache of one function, in the folder of its digest."""

    def __init__(self, function: Callable[..., Any], digest: str) -> None:
        name = function.__module__.rpartition(".")[2]
        locator = _Locator(name, digest, function.__code__.co_firstlineno)
        self._impl_class = partial(_Storage, locator=locator)  # type: ignore[assignment]
        super().__init__(function)


def kernel(*functions: Callable[..., Any], digest: str = "", **options: Any) -> Any:
    """Compile a function with numba; `@kernel` or `@kernel(nogil=True)`.

    Parameters
    ----------
    functions : the function, where used without brackets
    digest : of the sources, where the function stands in no file; found from its file by default
    options : of `numba.njit`; `error_model` is "numpy" unless given

    Returns
    -------
    The compiled function; on first call with new types it is compiled, or loaded from the cache.
    """
    if not functions:
        return lambda function: kernel(function, digest=digest, **options)
    (function,) = functions
    compiled = numba.njit(**{"error_model": "numpy", **options})(function)
    stamp = digest or source_digest(function.__code__.co_filename)
    compiled._cache = _KernelCache(function, stamp)
    return compiled
