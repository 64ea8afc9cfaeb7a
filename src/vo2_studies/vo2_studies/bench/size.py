"""How many lines of Python the installed packages have, the studies left out."""

from __future__ import annotations

import importlib.util
from pathlib import Path

from vo2_studies.bench.entry import Entry, Figure

__all__ = ["ENTRIES", "PACKAGES", "library_lines"]

PACKAGES = (
    "vo2_models",
    "vo2_interface",
    "vo2_plant_sim",
    "vo2_estimation",
    "vo2_control",
    "vo2_identification",
)


def library_lines() -> Figure:
    """Lines of all files of the libraries and nodes, as `wc -l` counts them."""
    counts = {}
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        if spec is None or spec.origin is None:
            raise ImportError(f"bench: found no package {package}, need all of {', '.join(PACKAGES)}")
        files = sorted(Path(spec.origin).resolve().parent.rglob("*.py"))
        counts[package] = sum(file.read_bytes().count(b"\n") for file in files)
    return Figure(float(sum(counts.values())), "lines", note=", ".join(f"{k} {n}" for k, n in counts.items()))


ENTRIES = (Entry("library_lines", library_lines, 30_000.0),)
