"""Pages of the API reference: one per package folder, with every module that declares public names."""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

SOURCES = Path(__file__).resolve().parents[2] / "src"
PACKAGES = (
    "vo2_models",
    "vo2_interface",
    "vo2_plant_sim",
    "vo2_estimation",
    "vo2_control",
    "vo2_identification",
)


def folders() -> dict[str, list[str]]:
    """Return dotted package folder -> its modules with an `__all__`, the folder itself first, all sorted."""
    found: dict[str, list[str]] = {}
    for package in PACKAGES:
        root = SOURCES / package
        for path in sorted((root / package).rglob("*.py")):
            if not re.search(r"^__all__\b", path.read_text(encoding="utf-8"), re.MULTILINE):
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
    """Add the reference to the navigation."""
    pages = [{folder: f"api/{folder}.md"} for folder in folders()]
    config.nav = [*(config.nav or []), {"API reference": pages}]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages, which are in no folder."""
    for folder, modules in folders().items():
        files.append(File.generated(config, f"api/{folder}.md", content=page(folder, modules)))
    return files
