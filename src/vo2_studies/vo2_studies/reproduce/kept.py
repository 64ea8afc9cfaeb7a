"""Finished sections kept on disk, so that an interrupted run continues: only those of the same code and settings."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from vo2_models.io import write_whole

from vo2_studies.reproduce.claims import Claim, Figure, Rule, Section, Table

__all__ = ["code_digest", "keep", "kept"]

_PACKAGES = (
    "vo2_models",
    "vo2_interface",
    "vo2_plant_sim",
    "vo2_estimation",
    "vo2_control",
    "vo2_identification",
    "vo2_studies",
)
_SOURCES = {".py", ".yaml", ".json", ".csv"}
_IMPORTED = re.compile(r"reproduce\.sections\.(\w+)")


def code_digest(module: ModuleType) -> str:
    """SHA-256 of every source and parameter file that a section may depend on.

    That is everything in the packages but the other sections that it does not import, and what only shows a section.
    """
    own = Path(str(module.__file__))
    used = {own.name, *(f"{name}.py" for name in _IMPORTED.findall(own.read_text(encoding="utf-8")))}
    digest = hashlib.sha256()
    for path, of_file in _digests().items():
        if (path.parent == own.parent and path.name not in used) or path in _shown(own):
            continue
        digest.update(of_file)
    return digest.hexdigest()


def _shown(section: Path) -> set[Path]:
    return {section.parents[1] / name for name in ("command.py", "kept.py", "page.py")}


@cache
def _digests() -> dict[Path, bytes]:
    """Every source of the packages, in a fixed order -> digest of its place and content."""
    found = {}
    for package in _PACKAGES:
        spec = find_spec(package)
        for place in (spec.submodule_search_locations or ()) if spec else ():
            root = Path(place)
            for path in sorted(p for p in root.rglob("*") if p.suffix in _SOURCES):
                name = f"{package}/{path.relative_to(root)}\n".encode()
                found[path] = hashlib.sha256(name + path.read_bytes()).digest()
    return found


def keep(
    folder: Path, module: ModuleType, section: Section, settings: Mapping[str, int], seconds: float
) -> None:
    """Write a finished section into `folder`.

    Parameters
    ----------
    module : of the section
    settings : what it depends on, besides the code
    seconds : how long it took

    Raises
    ------
    OSError : the folder cannot be written.
    """
    folder.mkdir(exist_ok=True)
    content = asdict(section)
    for claim in content["claims"]:
        claim["ours"] = float(claim["ours"]) if math.isfinite(claim["ours"]) else None
    content["story"] = [{"text": part} if isinstance(part, str) else asdict(part) for part in section.story]
    whole = {"code": code_digest(module), "settings": dict(settings), "seconds": seconds, "section": content}
    write_whole(
        _place(folder, section.number), json.dumps(whole, indent=1, allow_nan=False, default=float) + "\n"
    )


def kept(folder: Path, module: ModuleType, settings: Mapping[str, int]) -> tuple[Section, float] | None:
    """Return a section that an earlier run finished, and how long it took [s]; None if there is none to be used.

    One of other code or other settings is not used.
    """
    place = _place(folder, module.NUMBER)
    if not place.is_file():
        return None
    whole = json.loads(place.read_text(encoding="utf-8"))
    if whole["code"] != code_digest(module) or whole["settings"] != dict(settings):
        return None
    return _section(whole["section"]), float(whole["seconds"])


def _place(folder: Path, number: str) -> Path:
    return folder / f"{number}.json"


def _section(content: dict) -> Section:
    claims = tuple(
        Claim(**{
            **claim,
            "ours": math.nan if claim["ours"] is None else claim["ours"],
            "rule": Rule(**claim["rule"]),
        })
        for claim in content["claims"]
    )  # fmt: skip
    return Section(
        content["number"],
        content["title"],
        claims,
        tuple(Figure(**figure) for figure in content["figures"]),
        tuple(content["remarks"]),
        tuple(_part(part) for part in content["story"]),
    )


def _part(part: dict) -> str | Table | Figure:
    if "text" in part:
        return part["text"]
    if "svg" in part:
        return Figure(**part)
    return Table(part["caption"], tuple(part["head"]), tuple(tuple(row) for row in part["rows"]))
