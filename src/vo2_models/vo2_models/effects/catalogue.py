"""The catalogue of effects: what this folder holds, and a user's own files beside it.

A user's own effects are the files of the folders that the variable `VO2_EFFECTS` lists (`--effects DIR` sets it), and
what installed packages offer under the entry point `vo2_models.effects` (a module each).
"""

from __future__ import annotations

import argparse
import importlib.util
import inspect
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

from vo2_models.effects.record import HOOKS, PLAIN, Effect
from vo2_models.effects.trial import try_functions
from vo2_models.io import one_line

__all__ = [
    "VARIABLE",
    "add_effects_option",
    "check_hooks",
    "effect",
    "effect_ids",
    "effects",
    "load_effect",
    "module_of",
]

_OURS = "vo2_models.effects."
_MACHINERY = ("catalogue", "magnitude", "record", "skeleton", "trial")
_COMPILED = "vo2_models.device.generated"
"""Module that is generated from the effects when it is first imported."""
VARIABLE = "VO2_EFFECTS"
"""Environment variable with folders of effect files; a variable, so that processes that are started have it too."""


def add_effects_option(parser: argparse.ArgumentParser) -> None:
    """Give the `parser` of a command the option `--effects DIR`; it counts from the moment it is read."""
    parser.add_argument(
        "--effects",
        type=Path,
        action=_TakeEffects,
        metavar="DIR",
        help="folder with effect files of your own; may be repeated",
    )


class _TakeEffects(argparse.Action):
    """Note a folder in the environment, so that processes that are started have it too."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        folders = [f for f in os.environ.get(VARIABLE, "").split(os.pathsep) if f]
        if str(values.resolve()) in folders:
            return
        if _COMPILED in sys.modules:
            parser.exit(
                2,
                f"{parser.prog}: --effects {values}: found a simulation in use in this process, which holds the effects there "
                f"were then; need a new process, or {VARIABLE}={values} set before the first use\n",
            )
        os.environ[VARIABLE] = os.pathsep.join(dict.fromkeys([*folders, str(values.resolve())]))
        effects.cache_clear()
        try:
            effects()
        except ValueError as error:
            parser.exit(2, f"{parser.prog}: {one_line(error)}\n")


def _modules() -> Iterator[ModuleType]:
    import vo2_models.effects as folder

    for module in sorted(iter_modules(folder.__path__), key=lambda m: m.name):
        if module.name not in _MACHINERY:
            yield import_module(f"{folder.__name__}.{module.name}")
    for name in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        place = Path(name)
        if not place.is_dir():
            raise ValueError(f"--effects {place}: found no such folder, need one with effect files")
        files = sorted(place.glob("*.py"))
        if not files:
            raise ValueError(f"--effects {place}: found no Python file, need one that defines EFFECT")
        yield from map(module_of, files)
    for point in sorted(entry_points(group="vo2_models.effects"), key=lambda p: p.name):
        yield point.load()


def module_of(file: Path) -> ModuleType:
    """Import one effect file and return the module.

    Parameters
    ----------
    file : of the effect

    Raises
    ------
    ValueError : the file is no module, or raises something itself.
    """
    name = f"vo2_effects_{file.stem}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ValueError(f"{file}: cannot be imported; need a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        sys.modules.pop(name, None)
        raise ValueError(f"{file}: cannot be imported ({type(error).__name__}: {error})") from error
    return module


def load_effect(module: ModuleType) -> Effect:
    """Return the effect of a module, with its hooks, checked.

    Raises
    ------
    ValueError : no EFFECT in it, another id than the file's name, or whatever `Effect.check` and `try_functions` find.
    """
    file = str(module.__file__)
    record = getattr(module, "EFFECT", None)
    if not isinstance(record, Effect):
        raise ValueError(f"{file}: EFFECT: found {type(record).__name__}, need an Effect")
    if record.id != Path(file).stem:
        raise ValueError(f"{file}: found id {record.id!r}, need the file's name")
    names = (*HOOKS, "advance", "settled", *PLAIN)
    hooks = {name: getattr(module, name) for name in names if callable(getattr(module, name, None))}
    complete = replace(record, hooks=hooks, file=file)
    try:
        complete.check()
        # the catalogue's own are tried by its tests: a node that only loads them does not wait for what they import
        if not module.__name__.startswith(_OURS):
            try_functions(complete)
    except (TypeError, AttributeError) as error:
        raise ValueError(
            f"{file}: EFFECT: found a value of another type than Effect says ({error})"
        ) from error
    return complete


def check_hooks(record: Effect) -> None:
    """Compile each hook by itself, so that what is wrong in it is told with file and hook.

    Parameters
    ----------
    record : with its hooks

    Raises
    ------
    ValueError : a hook that does not compile, or returns nothing on one of its branches; one line.
    """
    import numba

    many = {state.name for state in record.states if state.size > 1}
    for name, function in record.hooks.items():
        if name in PLAIN:
            continue
        kinds = [
            numba.float64[:]
            if argument == "memory"
            else numba.int64
            if argument in many or argument == "sample"
            else numba.float64
            for argument in inspect.signature(function).parameters
        ]
        compiled = numba.njit(function)
        try:
            compiled.compile(tuple(kinds))
        except Exception as error:  # numba raises whatever the code makes it stumble over
            found = next((line for line in str(error).splitlines() if "rror: " in line), str(error))
            raise ValueError(
                f"{record.file}: hook {name}: cannot be compiled ({one_line(found, 300)}); need plain arithmetic on its "
                "arguments"
            ) from error
        if isinstance(compiled.nopython_signatures[0].return_type, numba.types.Optional):
            raise ValueError(
                f"{record.file}: hook {name}: found None on one of its ways, need a value on each"
            )


@cache
def effects() -> Mapping[str, Effect]:
    """Return all effects by id, in alphabetical order; a user's own are behind the catalogue's.

    Raises
    ------
    ValueError : a file that is not sound, or an id that is there already.
    """
    found: dict[str, Effect] = {}
    for module in _modules():
        record = load_effect(module)
        if not module.__name__.startswith(_OURS):
            check_hooks(record)
        if record.id in found:
            raise ValueError(
                f"{record.file}: found the id {record.id!r} twice, need another name for the file"
            )
        found[record.id] = record
    return found


def effect_ids(device: str | None = None) -> tuple[str, ...]:
    """Return the ids of all effects, or of those that can occur on a device."""
    return tuple(key for key, record in effects().items() if device is None or record.occurs_on(device))


def effect(name: str) -> Effect:
    """Return one effect of the catalogue.

    Parameters
    ----------
    name : id

    Raises
    ------
    ValueError : lists the known ids.
    """
    if name not in effects():
        raise ValueError(f"effect: found {name!r}, need one of {', '.join(effects())}")
    return effects()[name]
