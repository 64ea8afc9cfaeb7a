"""Speed figures against yardsticks of the same run: `python -m vo2_models.bench`.

Each module of this package (and each module named by `--also`) offers a tuple `ENTRIES` of `Entry`; nothing else
lists them.
"""

from vo2_models.bench.entry import Entry, Figure

__all__ = ["Entry", "Figure"]
