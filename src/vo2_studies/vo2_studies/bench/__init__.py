"""Speed figures against yardsticks of the same run: `python -m vo2_studies.bench`.

Each module of this package offers a tuple `ENTRIES` of `Entry`; nothing else lists them.
"""

from vo2_studies.bench.entry import Entry, Figure

__all__ = ["Entry", "Figure"]
