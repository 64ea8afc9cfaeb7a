"""What no file of the packages holds, read from the syntax tree."""

import ast
from pathlib import Path

SOURCES = Path(__file__).resolve().parents[2]


def test_no_library_file_holds_an_assert():
    """`python -O` leaves asserts out: what may be wrong in use is raised, and what cannot be needs no statement."""
    files = [path for package in SOURCES.iterdir() for path in (package / package.name).rglob("*.py")]
    assert len(files) > 100
    found = [
        f"{path.relative_to(SOURCES)}:{node.lineno}"
        for path in files
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Assert)
    ]
    assert not found
