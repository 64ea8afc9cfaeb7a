"""The one way to read YAML that a stranger may have written.

The safe subset of PyYAML executes nothing, but it follows aliases that multiply (a few lines become gigabytes) and
recurses with the document (deep nesting ends the process). So the document is counted, event by event, before anything
is built from it.

====================  =========================================================
limit                 value
====================  =========================================================
size of the text      16 MB
nesting               32
nodes                 100 000, each alias counted as all that it stands for
plain scalar          10 000 characters (YAML 1.1 reads long ones as base 60)
tags                  none: a document says what it is by its form
====================  =========================================================

Together they bound the memory at some 150 MB, and a model file of 20 000 numbers takes 10 MB.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from vo2_models.io.files import InputError, one_line, read_bytes

__all__ = ["load_yaml", "read_yaml"]

_MOST_BYTES = 1 << 24
_DEEPEST = 32
_MOST_NODES = 100_000
_LONGEST_PLAIN = 10_000
# the same safe subset in C where PyYAML has it: ten times as fast, and a model is some ten thousand numbers
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_yaml(path: str | Path) -> Any:
    """Return the document of a YAML file in UTF-8; None where it is empty.

    Parameters
    ----------
    path : of the file

    Raises
    ------
    InputError : not a regular file, not YAML, or beyond a limit; names the file and the place in it.
    """
    return load_yaml(read_bytes(path, _MOST_BYTES), str(path))


def load_yaml(text: str | bytes, where: str) -> Any:
    """Return the document of a YAML text; None where it is empty.

    Parameters
    ----------
    text : the document; bytes in UTF-8, a byte order mark is skipped
    where : what it is, for the messages

    Raises
    ------
    InputError : not YAML, or beyond a limit; names the place.
    """
    if len(text) > _MOST_BYTES:
        raise InputError(
            f"{where}: found {len(text) / 1e6:.6g} MB of YAML, need at most {_MOST_BYTES / 1e6:g} MB"
        )
    try:
        plain = text.decode("utf-8-sig") if isinstance(text, bytes) else text
        _count(plain, where)
        return yaml.load(plain, Loader=_LOADER)
    except InputError:
        raise
    except UnicodeDecodeError as error:
        raise InputError(f"{where}: byte {error.start} is not UTF-8, need a YAML text in UTF-8") from error
    except yaml.YAMLError as error:
        raise InputError(f"{where}: is not YAML ({one_line(error, 300)})") from error
    # what PyYAML raises on a scalar that looks like a date or number and is none: 2020-99-99, 5000 digits
    except (ValueError, TypeError, AttributeError, LookupError, OverflowError) as error:
        raise InputError(
            f"{where}: holds a value that YAML cannot read ({one_line(error, 200)}); quote it"
        ) from error


def _count(text: str, where: str) -> None:
    """Refuse a document beyond the limits, before anything is built from it."""
    nodes = 0
    depth = 0
    expanded: dict[str, int] = {}  # anchor -> nodes below it
    begun: list[tuple[str | None, int]] = []  # open collections: anchor, nodes before them

    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.NodeEvent):
            nodes += 1
            if isinstance(event, yaml.AliasEvent):
                if event.anchor not in expanded:
                    raise _refusal(
                        event, where, f"an alias to {event.anchor!r}, which is not complete before it"
                    )
                nodes += expanded[event.anchor] - 1
            elif event.tag is not None:
                raise _refusal(event, where, f"the tag {event.tag!r}, need a document without tags")
            if isinstance(event, yaml.ScalarEvent):
                if not event.style and len(event.value) > _LONGEST_PLAIN:
                    raise _refusal(
                        event,
                        where,
                        f"{len(event.value)} characters without quotes, need at most {_LONGEST_PLAIN}",
                    )
                if event.anchor:
                    expanded[event.anchor] = 1
            if nodes > _MOST_NODES:
                raise _refusal(
                    event, where, f"more than {_MOST_NODES} values, aliases counted as what they stand for"
                )
        if isinstance(event, yaml.CollectionStartEvent):
            begun.append((event.anchor, nodes - 1))
            depth += 1
            if depth > _DEEPEST:
                raise _refusal(event, where, f"lists or mappings nested deeper than {_DEEPEST}")
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = begun.pop()
            depth -= 1
            if anchor:
                expanded[anchor] = nodes - before


def _refusal(event: yaml.Event, where: str, found: str) -> InputError:
    return InputError(f"{where}: line {event.start_mark.line + 1}: found {found}")
