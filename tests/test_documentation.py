"""The documentation is true: its examples run, in the order of the page, and it holds no path of this machine."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from vo2_models.device.description import PRESETS
from vo2_models.effects import effects
from vo2_models.hysteresis.laws import LAWS

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*(ROOT / "docs").rglob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"])
BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WITH_EXAMPLES = [page for page in PAGES if BLOCK.search(page.read_text(encoding="utf-8"))]


def test_tutorials_have_examples():
    assert {
        "fit_your_rig.md",
        "your_bags.md",
        "read_a_diagnosis.md",
        "add_a_law.md",
        "add_an_effect.md",
        "index.md",
    } <= {p.name for p in WITH_EXAMPLES}


@pytest.mark.parametrize("page", WITH_EXAMPLES, ids=lambda page: page.name)
def test_examples_run(page, tmp_path):
    """Blocks marked python share one process, those marked sh run between them, all in one new folder."""
    (tmp_path / "vo2").symlink_to(ROOT / "vo2")
    steps = ["import subprocess"]
    for language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            steps.append(text)
        else:
            steps.append(f"subprocess.run(['bash', '-eu', '-c', {text!r}], check=True)")
    (tmp_path / "page.py").write_text("\n".join(steps), encoding="utf-8")
    # the first entry of the path is the folder of the script: an example finds the files that it writes
    run = subprocess.run(
        [sys.executable, "-W", "ignore::UserWarning", "page.py"], cwd=tmp_path, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stdout + run.stderr


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_path_of_a_machine(page):
    found = re.findall(r"(?<![\w.])/(?:work|root|home|tmp)/\S*", page.read_text(encoding="utf-8"))
    assert not found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_those_that_there_are(page):
    """`./vo2 run PACKAGE EXECUTABLE` names an executable that is installed."""
    text = page.read_text(encoding="utf-8")
    for package, executable in re.findall(r"\./vo2 run (vo2_\w+) ([a-z][\w-]*)", text):
        place = ROOT / "install" / package / "lib" / package / executable
        assert os.access(place, os.X_OK), f"{page.name}: {package} {executable}"


def test_the_catalogues_of_the_site_hold_every_effect_and_every_law():
    pages = runpy.run_path(str(ROOT / "docs" / "tools" / "api_pages.py"))
    written = pages["effects_page"]()
    for name, record in effects().items():
        assert f"## {name}\n\n{record.statement}" in written and record.equation in written
        assert all(f"| `{parameter.name}` |" in written for parameter in record.parameters)
    assert all(f"## {name}\n" in pages["laws_page"]() for name in LAWS)
    modules = {module for folder in pages["folders"]().values() for module in folder}
    assert {law.__module__ for law in LAWS.values()} <= modules


def test_every_shipped_device_is_told_of():
    texts = {"device.md": (ROOT / "docs" / "theory" / "device.md").read_text(encoding="utf-8")}
    for path in (ROOT / "src").glob("*/*/**/*.py"):
        for told in re.findall(
            r'"Device: integrated.*or the path of a device file', path.read_text(encoding="utf-8")
        ):
            texts[path.name] = told
    assert len(texts) > 5
    for name, text in texts.items():
        assert [device for device in PRESETS if not re.search(rf"\b{device}\b", text)] == [], name


def test_each_promise_names_a_test_that_is_there():
    text = (ROOT / "docs" / "promises.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w/]*test_\w+\.py)`", text))
    there = [
        str(path.relative_to(ROOT))
        for folder in ("tests", "src")
        for path in (ROOT / folder).rglob("test_*.py")
    ]
    assert len(named) > 10
    assert {name for name in named if not any(path.endswith(name) for path in there)} == set()
