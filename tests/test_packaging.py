"""What the packages say of themselves agrees."""

import re
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
    setup = (package / "setup.py").read_text()
    assert not re.search(r'version="|maintainer="|license="', setup), "these are read from package.xml"
    assert f'NAME = "{package.name}"' in setup
