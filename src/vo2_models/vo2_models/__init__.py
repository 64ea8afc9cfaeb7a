"""Hysteresis operators, device physics and self-sensing for thermal phase-transition actuators.

Importing this package loads nothing heavy: every public module is loaded when it is first touched, so
that a command that only parses its arguments does not wait for the compiler.
"""

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType

__version__ = "0.1.0"
__all__ = sorted(module.name for module in iter_modules(__path__) if not module.name.startswith("_"))


def __getattr__(name: str) -> ModuleType:
    """Load a public module on first use (PEP 562)."""
    if name in __all__:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
