"""What the packages say of themselves agrees."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.parent for path in ROOT.glob("src/*/package.xml"))


def element(package, name):
    return ElementTree.parse(package / "package.xml").getroot().find(name)


def test_one_version_everywhere():
    versions = {package.name: element(package, "version").text for package in PACKAGES}
    assert len(PACKAGES) >= 7 and len(set(versions.values())) == 1, versions


def test_the_installed_version_is_that_of_package_xml():
    import vo2_models

    assert vo2_models.__version__ == element(ROOT / "src" / "vo2_models", "version").text


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_each_package_brings_licence_and_changelog(package):
    assert (package / "LICENSE").read_text() == (ROOT / "LICENSE").read_text()
    title = f"Changelog for package {package.name}"
    assert title in (package / "CHANGELOG.rst").read_text()
    assert element(package, "maintainer").get("email") and element(package, "license").text == "MIT"
    if element(package, "export/build_type").text == "ament_cmake":
        return  # its version stands in package.xml alone
    setup = (package / "setup.py").read_text()
    assert not re.search(r'version="|maintainer="|license="', setup), "these are read from package.xml"
    assert f'NAME = "{package.name}"' in setup


def linter(name, *arguments):
    """What a linter of ament says, with the settings of this workspace, of all packages and tests."""
    pytest.importorskip(name, reason="the linters of ament come with ROS 2 only, not from PyPI")
    command = [
        sys.executable,
        "-c",
        f"import sys; from {name}.main import main; sys.exit(main())",
        *arguments,
    ]
    return subprocess.run([*command, "src", "tests"], cwd=ROOT, capture_output=True, text=True)


def test_ament_flake8_finds_nothing():
    done = linter("ament_flake8", "--config", ".flake8")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


def test_ament_pep257_finds_nothing():
    ignored = [f"D10{k}" for k in range(8)] + ["D401", "D402", "D403"]
    done = linter("ament_pep257", "--convention", "pep257", "--add-ignore", *ignored, "--")
    assert done.returncode == 0, done.stderr[-2000:]


def test_ruff_checks_the_rules_that_the_linters_of_ament_check():
    """Where those linters are not installed, it is ruff that finds what they would."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["ruff"]["lint"]
    assert {"E", "F", "W", "C4", "A", "D"} <= set(settings["select"])
    listed = re.findall(r"\b[A-Z]+[0-9]+\b", re.sub("#.*", "", (ROOT / ".flake8").read_text()))
    letters = {code for code in settings["ignore"] if code[0] in "DA"}
    assert letters <= set(listed)
