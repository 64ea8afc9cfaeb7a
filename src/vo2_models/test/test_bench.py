"""The benchmark framework: discovery, selection, verdicts, the JSON file, and a yardstick that is really compiled."""

import ctypes
import json
import subprocess
import sys

import numpy as np
import pytest
from vo2_models.bench import Entry, Figure, runner
from vo2_models.bench.runner import entries, main, select, table
from vo2_models.bench.timing import aligned, alternate, compiled_c, pointer

OURS = {"pi30_batch", "gpi30_batch", "egpi6_stream", "composite6_stream", "egpi6_inverse", "import"}


def test_entries_are_found_by_their_contract_names():
    known = entries()
    assert set(known) >= OURS
    assert all(name == entry.name for name, entry in known.items())


def test_a_further_module_adds_entries(tmp_path, monkeypatch):
    (tmp_path / "bench_extra_here.py").write_text(
        "from vo2_models.bench import Entry, Figure\n"
        "ENTRIES = (Entry('extra', lambda: Figure(2.0, 's', 4.0), 1.0, 'ratio'),)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    target = tmp_path / "out" / "bench.json"
    assert main(["--only", "extra", "--also", "bench_extra_here", "--json", str(target)]) == 0
    assert json.loads(target.read_text()) == {
        "extra": {"value": 2.0, "unit": "s", "yardstick": 4.0, "ratio": 0.5}
    }


def test_other_packages_of_the_workspace_add_entries(tmp_path, monkeypatch, capsys):
    for name, text in (
        (
            "bench_here",
            "from vo2_models.bench import Entry, Figure\nENTRIES = (Entry('far', lambda: Figure(3.0, 's')),)\n",
        ),
        ("bench_broken", "import no_such_middleware\n"),
        ("other", "raise RuntimeError('must not be imported')\n"),
    ):
        folder = tmp_path / "vo2_elsewhere"
        folder.mkdir(exist_ok=True)
        (folder / "__init__.py").touch()
        (folder / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    ours = [name for name in runner.companions() if name.startswith("vo2_elsewhere.")]
    assert ours == ["vo2_elsewhere.bench_broken", "vo2_elsewhere.bench_here"]
    monkeypatch.setattr(runner, "companions", lambda: ours)
    assert main(["--only", "far"]) == 0
    shown = capsys.readouterr()
    assert "far" in shown.out
    assert "bench: vo2_elsewhere.bench_broken left out: No module named 'no_such_middleware'" in shown.err


def test_unusable_input_is_one_line_and_status_2(capsys, monkeypatch):
    monkeypatch.setattr(runner, "companions", list)
    assert main(["--only", "nothing_like_it"]) == 2
    assert main(["--also", "no_such_module_anywhere"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "found nothing_like_it, need some of" in lines[0]
    assert "no_such_module_anywhere, which cannot be imported" in lines[1]


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
    assert theirs is not None
    assert theirs > 0
    with pytest.raises(RuntimeError, match="gcc: refused the yardstick"), compiled_c("this is not C"):
        pass


def test_importing_the_package_loads_no_compiler():
    code = (
        "import sys, vo2_models, vo2_models.hysteresis, vo2_models.bench;"
        "sys.exit(any(name in sys.modules for name in ('numba', 'scipy')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
