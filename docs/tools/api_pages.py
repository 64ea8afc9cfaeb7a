"""Pages that are made of the code: the catalogues of effects and of hysteresis laws, and the API reference.

The reference has one page per package folder, with every module that declares public names.
"""

import inspect
import re
from collections.abc import Iterable
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from vo2_models.effects import effects
from vo2_models.effects.magnitude import NEEDS
from vo2_models.hysteresis.laws import LAWS

SOURCES = Path(__file__).resolve().parents[2] / "src"
PACKAGES = (
    "vo2_models",
    "vo2_interface",
    "vo2_plant_sim",
    "vo2_estimation",
    "vo2_control",
    "vo2_identification",
)


LAW_FILES = SOURCES / "vo2_models" / "vo2_models" / "hysteresis" / "laws"
"""A file of this folder is a law, whether it lists public names or not."""


def effects_page() -> str:
    """Return the Markdown of the catalogue of effects."""
    parts = [
        "# Catalogue of effects\n\nOne file each in `vo2_models/effects`; at its neutral values an effect is off.\n"
    ]
    for one in effects().values():
        needs = [f"needs {NEEDS[need]}" for need in one.needs]
        facts = [
            f"Family `{one.family('CHANNEL')}`",
            f"reaches {', '.join(f'`{c}`' for c in one.channels)}",
            *needs,
        ]
        rows = [
            (f"`{p.name}`", f"{p.default:g}", p.unit, f"{p.lower:g} to {p.upper:g}", p.description)
            for p in one.parameters
        ]
        parts += [
            f"## {one.id}\n\n{one.statement}\n\n```text\n{one.equation}\n```\n",
            table(("parameter", "neutral", "unit", "bounds", "meaning"), rows),
            f"{'; '.join(facts)}. Shown by: {one.excitation}. Source: {one.source}.\n",
        ]
    return "\n".join(parts)


def laws_page() -> str:
    """Return the Markdown of the catalogue of hysteresis laws."""
    parts = [
        "# Hysteresis laws\n\nBy the name that a model file has; {y} is the unit of the output, {u} of the input.\n"
    ]
    for name, law in LAWS.items():
        words = (inspect.getdoc(law) or "").partition("\n\n")[0]
        place = f"../api/{law.__module__.rpartition('.')[0]}.md#{law.__module__}.{law.__name__}"
        rows = [(f"`{field}`", unit, text.rstrip(",")) for field, (unit, text) in law.described.items()]
        parts += [
            f"## {name}\n\n[{law.__name__}]({place}): {words}\n",
            table(("parameter", "unit", "meaning"), rows),
        ]
    return "\n".join(parts)


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', '&#124;') for cell in line)} |\n" for line in lines)


CATALOGUES = {"catalogue/effects.md": effects_page, "catalogue/laws.md": laws_page}
"""Path of a page -> what writes it."""


def folders() -> dict[str, list[str]]:
    """Return dotted package folder -> its modules with an `__all__` and those of laws, the folder itself first, all sorted."""
    found: dict[str, list[str]] = {}
    for package in PACKAGES:
        root = SOURCES / package
        for path in sorted((root / package).rglob("*.py")):
            public = re.search(r"^__all__\b", path.read_text(encoding="utf-8"), re.MULTILINE)
            if not public and path.parent != LAW_FILES:
                continue
            parts = list(path.relative_to(root).with_suffix("").parts)
            if parts[-1] == "__init__":
                continue
            found.setdefault(".".join(parts[:-1]), []).append(".".join(parts))
    return found


def page(folder: str, modules: list[str]) -> str:
    """Return the Markdown of one page."""
    return f"# {folder}\n\n" + "\n".join(f"::: {module}\n" for module in modules)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add catalogues and reference to the navigation."""
    effects_at, laws_at = CATALOGUES
    pages = [{folder: f"api/{folder}.md"} for folder in folders()]
    made = [{"Effects": effects_at}, {"Hysteresis laws": laws_at}, {"API reference": pages}]
    config.nav = [*(config.nav or []), *made]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, which are in no folder."""
    for place, write in CATALOGUES.items():
        files.append(File.generated(config, place, content=write()))
    for folder, modules in folders().items():
        files.append(File.generated(config, f"api/{folder}.md", content=page(folder, modules)))
    return files
