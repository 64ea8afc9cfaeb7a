"""What `--help` of a node says: what it does, and every parameter with default, unit, range and meaning."""

from __future__ import annotations

import inspect
import sys
import textwrap
from types import ModuleType

from vo2_models.parameters import Parameter

__all__ = ["ARGUMENTS", "usage"]

ARGUMENTS = (
    "nodes take ROS arguments only: --ros-args -p NAME:=VALUE, --params-file FILE, -r __ns:=/NAMESPACE; "
    "--help lists the parameters"
)
_MODEL = "model."
_WIDTH = 110
_INDENT = 6 * " "


def usage(module: ModuleType | None) -> str:
    """Return the help of the node in a module: its docstring and the `*_PARAMETERS` that the module holds.

    The parameters of a fitted model are not listed one by one: a file brings them.
    """
    records: dict[str, Parameter] = {}
    model = False
    for name, value in vars(module).items() if module else ():
        if name.endswith("_PARAMETERS") and isinstance(value, tuple):
            for record in value:
                model |= record.name.startswith(_MODEL)
                if not record.name.startswith(_MODEL):
                    records[record.name] = record
        # a node that is built on another takes what that takes
        bases = getattr(value, "__mro__", ())
        takes = any(hasattr(sys.modules.get(base.__module__), "model_parameters") for base in bases)
        model |= name == "model_parameters" or takes
    parts = [inspect.getdoc(module) or ""]
    if records:
        parts.append("Parameters:\n" + "\n".join(map(_entry, records.values())))
    if model:
        parts.append(
            "The `model.*` parameters come from a file that `fit` or `identifier` wrote: --params-file FILE."
        )
    return "\n\n".join(parts)


def _entry(record: Parameter) -> str:
    low, high = record.lower, record.upper
    allowed = ""
    if record.choices:
        allowed = f"; one of {', '.join(record.choices)}"
    elif low is not None and high is not None:
        allowed = f"; {low:g} to {high:g}"
    elif low is not None:
        allowed = f"; at least {low:g}"
    elif high is not None:
        allowed = f"; at most {high:g}"
    unit = f" {record.unit}" if record.unit not in ("", "1") else ""
    shown = repr(record.default) if isinstance(record.default, str) else f"{record.default}{unit}"
    head = f"  {record.name} ({record.type}, default {shown}{allowed})"
    meaning = textwrap.fill(
        record.description, _WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT, break_on_hyphens=False
    )
    return f"{head}\n{meaning}"
