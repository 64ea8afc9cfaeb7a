"""The model file: flat `model.*` parameters that every node loads, as `ros2 param load` reads them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from vo2_models.parameters import Value

__all__ = ["load_model_parameters", "save_model_parameters"]

_PREFIX = "model."
# the same safe subset in C where PyYAML has it: ten times as fast, and a model is some ten thousand numbers
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
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
    """
    plain: dict[str, object] = {}
    for name, value in sorted(parameters.items()):
        if not name.startswith(_PREFIX):
            raise ValueError(f"{name}: a model file holds only names that start with {_PREFIX}")
        array = np.asarray(value)
        if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
            raise ValueError(f"{name}: found a value that is not finite; a model file needs finite numbers")
        plain[name] = array.tolist()
    target = Path(path)
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    tree = {"/**": {"ros__parameters": plain}}
    text = head + yaml.dump(tree, Dumper=_DUMPER, sort_keys=True, width=100)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, partial = tempfile.mkstemp(dir=target.parent, prefix=target.name, suffix=".part")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
        os.chmod(partial, 0o644)
        os.replace(partial, target)
    except BaseException:
        os.unlink(partial)  # a full disk or Ctrl-C leaves nothing beside the place
        raise


def load_model_parameters(path: str | Path) -> dict[str, Value]:
    """Read the flat `model.*` parameters of a file that `save_model_parameters` or a node wrote.

    Raises
    ------
    ValueError : not a ROS parameter file, or no `model.*` in it; the message names the file.
    """
    try:
        content = yaml.load(Path(path).read_text(encoding="utf-8"), Loader=_LOADER)
    except OSError as error:
        raise ValueError(
            f"{path}: cannot be read ({error.strerror}); give a file that `fit` wrote"
        ) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        why = " ".join(str(error).split())
        raise ValueError(f"{path}: is not YAML ({why}); give a file that `fit` wrote") from error
    found: dict[str, Value] = {}
    for section in (content or {}).values() if isinstance(content, dict) else ():
        if isinstance(section, dict):
            _flatten("", section.get("ros__parameters", {}), found)
    model = {name: value for name, value in found.items() if name.startswith(_PREFIX)}
    if not model:
        raise ValueError(f"{path}: holds no model.* parameters; give a file that `fit` wrote")
    return model


def _flatten(prefix: str, tree: object, into: dict[str, Value]) -> None:
    """Collect nested mappings under dotted names; both spellings are legal in a ROS parameter file."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            _flatten(f"{prefix}.{key}" if prefix else str(key), value, into)
    else:
        into[prefix] = tree  # type: ignore[assignment]
