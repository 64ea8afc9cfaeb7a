"""The model file: flat `model.*` parameters that every node loads, as `ros2 param load` reads them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from vo2_models.io import InputError, check_place, check_regular, load_yaml, read_bytes, write_whole
from vo2_models.parameters import Value

__all__ = ["check_model_place", "load_model_parameters", "save_model_parameters"]

_PREFIX = "model."
_WHOLE, _END = b"# whole if it ends with ...\n", b"..."
"""A line at the head of a file that ends with YAML's mark of a document's end: what was cut off is told from it."""
_MOST_BYTES = 1 << 24
# in C where PyYAML has it: ten times as fast, and a model is some ten thousand numbers
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def save_model_parameters(path: str | Path, parameters: Mapping[str, Value], *, comment: str = "") -> None:
    """Write flat `model.*` parameters as a ROS 2 parameter file for any node (`/**`).

    The file appears whole or not at all: it is written beside its place and then moved there.

    Parameters
    ----------
    path : file to write
    parameters : name (starting with `model.`) -> number, text, or flat list
    comment : text for the head of the file

    Raises
    ------
    ValueError : a name outside `model.`, or a value that is not finite.
    OSError : the file cannot be written.
    """
    plain: dict[str, object] = {}
    for name, value in sorted(parameters.items()):
        if not name.startswith(_PREFIX):
            raise ValueError(f"{name}: a model file holds only names that start with {_PREFIX}")
        array = np.asarray(value)
        if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
            raise ValueError(f"{name}: found a value that is not finite; a model file needs finite numbers")
        plain[name] = array.tolist()
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    tree = {"/**": {"ros__parameters": plain}}
    document = yaml.dump(tree, Dumper=_DUMPER, sort_keys=True, width=100, explicit_end=True)
    write_whole(path, head + _WHOLE.decode() + document)


def check_model_place(path: str | Path, mark: str) -> None:
    """Refuse before the work a place where a model file could not be written after it.

    Parameters
    ----------
    path : of the file to come
    mark : begins the comment of a file that the command wrote and may replace

    Raises
    ------
    InputError : a folder, a place that cannot be written, or a file that was not written by the command.
    """
    place = Path(path)
    if place.is_dir():
        raise InputError(f"{place}: is a folder, need the name of a file, such as {place / 'model.yaml'}")
    check_place(place)
    if place.exists():
        check_regular(place)
        with place.open("rb") as file:
            if not file.read(len(mark) + 2).decode(errors="replace").startswith(f"# {mark}"):
                raise InputError(f"{place}: exists and was not {mark}; move it away or name another file")


def load_model_parameters(path: str | Path) -> dict[str, Value]:
    """Read the flat `model.*` parameters of a file that `save_model_parameters` or a node wrote.

    Parameters
    ----------
    path : of the file

    Returns
    -------
    dict : name -> number, text or flat list

    Raises
    ------
    ValueError : not a ROS parameter file, one that was cut off, no `model.*` in it, or one that is neither finite numbers nor
        a text; the message names the file and the parameter.
    """
    try:
        text = read_bytes(path, _MOST_BYTES)
        if _WHOLE in text and not text.rstrip().endswith(_END):
            raise InputError(f"{path}: is cut off, its end is missing")
        content = load_yaml(text, str(path))
    except InputError as error:
        raise InputError(f"{error}; give a file that `fit` wrote") from error
    found: dict[str, Value] = {}
    for section in (content or {}).values() if isinstance(content, dict) else ():
        if isinstance(section, dict):
            _flatten("", section.get("ros__parameters", {}), found)
    model = {name: value for name, value in found.items() if name.startswith(_PREFIX)}
    if not model:
        raise InputError(f"{path}: holds no model.* parameters; give a file that `fit` wrote")
    for name, value in model.items():
        if not _is_value(value):
            raise InputError(
                f"{path}: {name}: found {value!r}, need finite numbers, texts or a flat list of one kind; "
                "give a file that `fit` wrote"
            )
    return model


def _is_value(value: object) -> bool:
    """Whether this is what a ROS parameter can hold."""
    if isinstance(value, list):
        kinds = {_kind(element) for element in value}
        return len(kinds) <= 1 and None not in kinds
    return _kind(value) is not None


def _kind(value: object) -> str | None:
    if isinstance(value, (bool, str)):
        return type(value).__name__
    if isinstance(value, int) and -(2**63) <= value < 2**63:
        return "number"
    return "number" if isinstance(value, float) and math.isfinite(value) else None


def _flatten(prefix: str, tree: object, into: dict[str, Value]) -> None:
    """Collect nested mappings under dotted names; both spellings are legal in a ROS parameter file."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            _flatten(f"{prefix}.{key}" if prefix else str(key), value, into)
    else:
        into[prefix] = tree  # type: ignore[assignment]
