"""Every package declares what it imports, by the keys that rosdep knows, so that `rosdep install` is enough."""

import ast
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[1] / "src"
PACKAGES = sorted(path.parent for path in SOURCES.glob("*/package.xml"))
KEYS = {
    "clarabel": "python3-clarabel-pip",
    "control": "python-control-pip",
    "hypothesis": "python3-hypothesis",
    "llvmlite": "python3-llvmlite",
    "jinja2": "python3-jinja2",
    "lz4": "python3-lz4",
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "openpyxl": "python3-openpyxl",
    "pyarrow": "python3-pyarrow-pip",
    "pytest": "python3-pytest",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "threadpoolctl": "python3-threadpoolctl",
    "tqdm": "python3-tqdm",
    "setuptools": "python3-setuptools",
    "yaml": "python3-yaml",
}
"""Module -> key of rosdistro's python.yaml or of rosdep.yaml here; a ROS package has its own name."""
WITHOUT_KEY = {"distributed"}
"""Comes with pip alone: the extra `dask` of vo2_identification."""
WITH_ANOTHER = {
    "cycler": "matplotlib",
    "backports": "rosbags",
    "compression": "rosbags",
    "slycot": "control",
}
"""Module -> the one whose installation brings it."""


def imported(folder):
    """Modules from outside the standard library that the Python files of a folder import, wherever in them."""
    files = list(folder.rglob("*.py"))
    local = {path.stem for path in files}
    found = set()
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {name.name.split(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
                found.add(node.module.split(".")[0])
    return found - set(sys.stdlib_module_names) - local - WITHOUT_KEY - set(WITH_ANOTHER)


def declared(package, *kinds):
    return {
        element.text
        for element in ElementTree.parse(package / "package.xml").getroot()
        if element.tag in kinds
    }


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_what_is_imported_is_declared(package):
    needed = {KEYS.get(module, module) for module in imported(package / package.name) - {package.name}}
    assert needed <= declared(package, "exec_depend", "depend")
    for_tests = {KEYS.get(module, module) for module in imported(package / "test") - {package.name}}
    assert for_tests <= declared(package, "exec_depend", "depend", "test_depend")
