"""rosbag2 bags: read what is there and say what is wrong, write what every rosbag2 tool reads.

>>> from vo2_identification.bags import read_recording, write_bag
>>> recording, problems = read_recording("my_bag")  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vo2_identification.bags.problems import BagError, Problem
    from vo2_identification.bags.reading import read_bag, read_recording
    from vo2_identification.bags.storage import RawMessage, raw_messages
    from vo2_identification.bags.writing import BagWriter, write_bag

__all__ = [
    "BagError",
    "BagWriter",
    "Problem",
    "RawMessage",
    "raw_messages",
    "read_bag",
    "read_recording",
    "write_bag",
]

_HOME = {
    "BagError": "problems",
    "Problem": "problems",
    "RawMessage": "storage",
    "raw_messages": "storage",
    "read_bag": "reading",
    "read_recording": "reading",
    "BagWriter": "writing",
    "write_bag": "writing",
}


def __getattr__(name: str) -> Any:
    # rosbags takes half a second to import: only who reads or writes a bag pays for it
    if name not in _HOME:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
