"""rosbag2 bags: read what is there and say what is wrong, write what every rosbag2 tool reads.

>>> from vo2_identification.bags import read_recording, write_bag
>>> recording, problems = read_recording("my_bag")  # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from vo2_models.lazy import lazy_names

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
__getattr__, __dir__ = lazy_names(__name__, _HOME)
