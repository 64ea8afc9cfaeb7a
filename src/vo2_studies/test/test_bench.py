"""The benchmark framework: discovery, selection, verdicts, the JSON file, and a yardstick that is really compiled."""

import ctypes
import functools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from vo2_studies.bench import Entry, Figure, runner
from vo2_studies.bench.runner import entries, main, select, table
from vo2_studies.bench.size import PACKAGES, library_lines
from vo2_studies.bench.timing import aligned, alternate, compiled_c, pointer

OURS = {"pi30_batch", "gpi30_batch", "egpi6_stream", "composite6_stream", "egpi6_inverse", "import"}


def test_entries_are_found_by_their_contract_names():
    known = entries()
    assert set(known) >= OURS
    assert all(name == entry.name for name, entry in known.items())


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package `elsewhere` of benchmarks, one of which cannot be imported here."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "far.py").write_text(
        "from vo2_studies.bench import Entry, Figure\n"
        "ENTRIES = (Entry('far', lambda: Figure(2.0, 's', 4.0), 1.0, 'ratio'),)\n"
    )
    (folder / "broken.py").write_text("import no_such_middleware\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(runner, "entries", functools.partial(entries, "elsewhere"))
    yield folder
    for name in [name for name in sys.modules if name.split(".")[0] == "elsewhere"]:
        del sys.modules[name]


def test_a_module_adds_entries_and_one_that_cannot_be_imported_is_named(package, tmp_path, capsys):
    target = tmp_path / "out" / "bench.json"
    assert main(["--only", "far", "--json", str(target)]) == 0
    shown = json.loads(target.read_text())
    assert shown == {"far": {"value": 2.0, "unit": "s", "yardstick": 4.0, "ratio": 0.5}}
    assert "bench: elsewhere.broken left out: No module named 'no_such_middleware'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"), [("X = 1\n", "found no ENTRIES"), (None, "found the name far twice")]
)
def test_a_module_without_entries_or_with_a_name_twice_is_refused(package, capsys, text, said):
    (package / "second.py").write_text((package / "far.py").read_text() if text is None else text)
    assert main(["--only", "far"]) == 2
    assert said in capsys.readouterr().err


def test_unusable_input_is_one_line_and_status_2(package, capsys):
    (package / "broken.py").unlink()
    assert main(["--only", "nothing_like_it"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "found nothing_like_it, need some of" in line


def test_select_keeps_the_order_asked_for():
    known = {name: Entry(name, lambda: Figure(1.0, "s")) for name in "abc"}
    assert [entry.name for entry in select(known, ["c", "a"])] == ["c", "a"]
    assert [entry.name for entry in select(known, [])] == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("entry", "figure", "met"),
    [
        (Entry("x", lambda: Figure(0, "s"), 2.0), Figure(2.0, "s"), True),
        (Entry("x", lambda: Figure(0, "s"), 2.0), Figure(2.1, "s"), False),
        (Entry("x", lambda: Figure(0, "s"), 2.0, "ratio"), Figure(3.0, "s", 2.0), True),
        (Entry("x", lambda: Figure(0, "s"), 2.0, "ratio"), Figure(3.0, "s"), None),
        (Entry("x", lambda: Figure(0, "s"), 2.0, above=True), Figure(1.0, "s"), False),
        (Entry("x", lambda: Figure(0, "s")), Figure(1.0, "s"), None),
    ],
)
def test_verdicts(entry, figure, met):
    assert entry.met(figure) is met
    assert ("NOT MET" in table(entry, figure)) == (met is False)


def test_the_yardstick_is_compiled_and_called():
    source = (
        "void twice(const double *x, long n, double *y) { for (long k = 0; k < n; k++) y[k] = 2 * x[k]; }"
    )
    x, y = aligned(np.arange(5)), aligned(np.zeros(5))
    assert x.ctypes.data % 64 == 0
    with compiled_c(source) as library:
        ours, theirs = alternate(
            lambda: 2 * x, lambda: library.twice(pointer(x), ctypes.c_long(5), pointer(y))
        )
    assert y.tolist() == [0, 2, 4, 6, 8]
    assert ours > 0
    assert theirs > 0
    with pytest.raises(RuntimeError, match="gcc: refused the yardstick"), compiled_c("this is not C"):
        pass


def test_importing_the_package_loads_no_compiler():
    code = (
        "import sys, vo2_models, vo2_models.hysteresis, vo2_studies.bench;"
        "sys.exit(any(name in sys.modules for name in ('numba', 'scipy')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_lines_are_those_of_the_libraries_and_nodes_without_the_studies():
    figure = library_lines()
    here = Path(__file__).resolve().parents[2]
    wanted = {
        package: sum(len(file.read_text().splitlines()) for file in (here / package / package).rglob("*.py"))
        for package in PACKAGES
    }
    assert figure.value == sum(wanted.values()) and "vo2_studies" not in figure.note
    assert all(f"{package} {count}" in figure.note for package, count in wanted.items())
