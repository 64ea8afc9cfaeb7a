"""Tables and maps that are damaged or made to harm: one line, status 2, in bounded time and memory, nothing written."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
import time
import tracemalloc
import zipfile

import pytest
from openpyxl import Workbook
from vo2_identification.bags import read_recording

from vo2_identification import convert

MAP = """
device: rig
header_row: 1
time: {column: t, unit: ms}
channels:
  heater_current: {column: I, unit: mA}
"""
TABLE = "t,I\n0,1\n1,2\n2,3\n"
MB = 1 << 20


def refused(tmp_path, capsys, *, text=MAP, table=None, file="table.csv", output="bag", most_mb=150.0):
    """Run `convert`; return what it said, after checking that this is one line and that nothing was written."""
    (tmp_path / "map.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    if table is not None:
        (tmp_path / file).write_bytes(table if isinstance(table, bytes) else table.encode())
    before = sorted(tmp_path.rglob("*"))
    arguments = ["--map", tmp_path / "map.yaml", "--input", tmp_path / file, "--output", tmp_path / output]
    tracemalloc.start()
    began = time.process_time()
    status = convert.main([str(each) for each in arguments])
    took, peak = time.process_time() - began, tracemalloc.get_traced_memory()[1] / MB
    tracemalloc.stop()
    said = capsys.readouterr().err.strip()
    assert status == 2, said
    assert len(said.splitlines()) == 1 and len(said) < 700 and said.isprintable()
    assert took < 20.0  # tracing memory makes it some five times as long
    assert peak < most_mb
    assert sorted(tmp_path.rglob("*")) == before
    return said


def workbook(
    path, *, replace=(), cells=((1, 1, "t"), (1, 2, "I"), (2, 1, 0), (2, 2, 1), (3, 1, 1), (3, 2, 2))
):
    """A workbook of these cells in whose sheet texts are replaced."""
    book = Workbook()
    for row, column, value in cells:
        book.active.cell(row, column, value)
    book.save(path)
    if replace:
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        name = "xl/worksheets/sheet1.xml"
        for old, new in replace:
            assert old in members[name]
            members[name] = members[name].replace(old, new)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members.items():
                archive.writestr(name, content)
    return path


@pytest.mark.parametrize(
    "name", ["../outside", "/tmp/outside", "a/../../b", "a\\b", "x\0y", "x" * 200, "a\nb"]
)
def test_a_series_cannot_name_a_place_outside_the_output(tmp_path, capsys, name):
    inside = tmp_path / "in"
    inside.mkdir()
    quoted = '"' + name.replace("\\", "\\\\").replace("\0", "\\0").replace("\n", "\\n") + '"'
    series = f"{quoted}: {{channels: {{heater_current: {{column: I, unit: mA}}}}}}"
    text = f"header_row: 1\ntime: {{column: t, unit: ms}}\nseries:\n  {series}\n  good: {series.split(':', 1)[1]}\n"
    said = refused(inside, capsys, text=text, table=TABLE, output="out")
    assert "need a name of at most 100 printable characters without slashes" in said


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (MAP + "description: " + "[" * 10_000, "nested deeper than 32"),
        (MAP.encode("utf-16"), "is not UTF-8"),
        (MAP.encode() + b"description: \xff", "byte 118 is not UTF-8"),
        (MAP + "a: &a [x,x]\nb: &b [*a,*a]\ndescription: *b\n", "found the key 'a'"),
        (MAP + "encoding: zlib", "encoding: found 'zlib'"),
        (MAP + "encoding: idna", "encoding: found 'idna'"),
        (MAP + 'encoding: "a\\0b"', "encoding: found"),
        (MAP + "encoding: utf-16", "is not utf-16; set encoding"),
        (MAP + "encoding: utf-32", "is not utf-32; set encoding"),
        (MAP + 'delimiter: "\\n"', "delimiter: found"),
        (MAP + 'delimiter: "\\""', "delimiter: found"),
        (MAP + "files: ../../*.csv", "files: found '../../*.csv'"),
        (MAP + 'files: "**"', "files: found"),
        (MAP.replace("header_row: 1", "header_row: -3"), "header_row: found -3"),
        (
            MAP.replace("header_row: 1", "header_row: 99999999999999999999"),
            "header_row: found 99999999999999999999",
        ),
        (MAP.replace("{column: t, unit: ms}", "{rate_hz: 1" + "0" * 400 + "}"), "rate_hz: found 1000"),
        (MAP.replace("{column: t, unit: ms}", "{rate_hz: 1.0e-300}"), "time"),
        (MAP.replace("{column: t, unit: ms}", "{rate_hz: .inf}"), "rate_hz: found inf"),
        (MAP.replace("unit: mA}", "unit: mA, scale: .nan}"), "found no value"),
        (MAP + "description: 2020-99-99", "quote it"),
        ("", "found NoneType"),
    ],
)
def test_a_map_that_cannot_be_used_is_one_line(tmp_path, capsys, text, said):
    assert said in refused(tmp_path, capsys, text=text, table=TABLE)


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ("XFD1048576", "need a number|found no value|found no column|million cells|header"),
        ("A999999999", "found a cell below row 1048576"),
    ],
)
def test_a_stray_cell_far_away_costs_little(tmp_path, capsys, cell, said):
    workbook(
        tmp_path / "table.xlsx",
        replace=[
            (b'<row r="3">', f'<row r="{cell.strip("AXFD")}">'.encode()),
            (b'r="A3"', f'r="{cell}"'.encode()),
        ],
    )
    text = MAP + "format: xlsx\n"
    if cell.startswith("A"):
        assert re.search(said, refused(tmp_path, capsys, text=text, file="table.xlsx"))
    else:  # an empty corner: the table is read all the same
        (tmp_path / "map.yaml").write_text(text)
        arguments = ["--map", "map.yaml", "--input", "table.xlsx", "--output", "bag"]
        began = time.process_time()
        assert (
            convert.main([str(tmp_path / each) if k % 2 else each for k, each in enumerate(arguments)]) == 0
        )
        assert time.process_time() - began < 10.0
        assert len(read_recording(tmp_path / "bag")[0]) == 1


def test_a_cell_at_the_far_right_of_every_row_is_refused_before_it_fills_the_memory(tmp_path, capsys):
    cells = [(row, 16_384, 1) for row in range(1, 800)]
    workbook(tmp_path / "table.xlsx", cells=cells)
    said = refused(tmp_path, capsys, text=MAP + "format: xlsx\n", file="table.xlsx", most_mb=200)
    assert "found more than 10 million cells" in said


def test_a_zip_bomb_is_refused_unopened(tmp_path, capsys):
    workbook(tmp_path / "table.xlsx", replace=[(b"</sheetData>", b" " * (300 * MB) + b"</sheetData>")])
    said = refused(tmp_path, capsys, text=MAP + "format: xlsx\n", file="table.xlsx", most_mb=20)
    assert "MB that expand to 314.6 MB, need at most 100 times" in said


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"<sheetData>", b"<sheetData><row>&lol;"),
        (b'r="A3"', b'r="3A"'),
        (b'<row r="3">', b'<row r="three">'),
        (b"</worksheet>", b""),
        (b't="n"><v>0</v>', b't="s"><v>999</v>'),
        (b't="n"><v>0</v>', b't="n"><v>' + b"9" * 5000 + b"</v>"),
        (b't="n"><v>0</v>', b't="d"><v>noon</v>'),
    ],
)
def test_a_damaged_workbook_is_one_line(tmp_path, capsys, old, new):
    workbook(tmp_path / "table.xlsx", replace=[(old, new)])
    said = refused(tmp_path, capsys, text=MAP + "format: xlsx\n", file="table.xlsx")
    assert "table.xlsx" in said


@pytest.mark.parametrize("form", ["csv", "xlsx"])
def test_a_fifo_a_device_or_a_folder_is_not_opened(tmp_path, capsys, form):
    text = MAP + f"format: {form}\n"
    os.mkfifo(tmp_path / "table")
    assert "found a FIFO, need a regular file" in refused(tmp_path, capsys, text=text, file="table")
    (tmp_path / "table").unlink()
    (tmp_path / "table").symlink_to("/dev/zero")
    assert "found a device file" in refused(tmp_path, capsys, text=text, file="table")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("t,I\n" + "1" * (2 * MB) + "\n", "line 2 has more than 1048576 characters"),
        ("t,I\n" + "," * (MB // 2) + "\n1,2\n", None),
        ("t,I\n" + ("," * 999_999 + "\n") * 11, "row 11: found more than 10 million cells"),
        ('t,I\n1,"' + "x" * 200_000, "field larger than field limit"),
        (b"t,I\n\xff,1\n", "is not utf-8"),
        ("t,I\n1e400,1\n", "no row has a time"),
        ("t,I\n0," + "9" * 100_000 + "\n", "found no value"),
        ("t,I\n0,\x1b[31m\n", "row 2, column 'I'"),
    ],
)
def test_a_table_that_is_too_large_or_no_table_is_one_line(tmp_path, capsys, table, said):
    if said is None:
        (tmp_path / "map.yaml").write_text(MAP)
        (tmp_path / "table.csv").write_text(table)
        arguments = ["--map", "map.yaml", "--input", "table.csv", "--output", "bag"]
        assert (
            convert.main([str(tmp_path / each) if k % 2 else each for k, each in enumerate(arguments)]) == 0
        )
    else:
        assert said in refused(tmp_path, capsys, table=table, most_mb=400)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_full_disk_is_one_line_that_names_the_bag_and_leaves_no_stub(tmp_path, storage):
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "table.csv").write_text("t,I\n" + "".join(f"{k},1\n" for k in range(20_000)))
    arguments = ["--map", "map.yaml", "--input", "table.csv", "--output", "bag", "--storage", storage]

    for limit in (1000, 200_000):  # no room to begin, no room to end

        def small_disk(limit=limit):
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        ended = subprocess.run(
            [sys.executable, "-B", "-m", "vo2_identification.convert", *arguments],
            cwd=tmp_path,
            preexec_fn=small_disk,
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 2
        assert len(ended.stderr.strip().splitlines()) == 1
        assert ended.stderr.startswith("convert: bag: cannot be written (")
        assert sorted(os.listdir(tmp_path)) == ["map.yaml", "table.csv"]


def test_a_decimal_comma_of_the_locale_changes_nothing(tmp_path):
    made = shutil.which("localedef") and subprocess.run(
        ["localedef", "-c", "-i", "de_DE", "-f", "UTF-8", tmp_path / "de_DE.UTF-8"], capture_output=True
    )
    if not made or not (tmp_path / "de_DE.UTF-8").exists():
        pytest.skip("no locale with a decimal comma can be made here")
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "table.csv").write_text("t,I\n0.5,1.5\n1.5,2.5\n")
    code = (
        "import locale, sys; locale.setlocale(locale.LC_ALL, ''); assert locale.str(1.5) == '1,5'\n"
        "from vo2_identification.convert import main; sys.exit(main(sys.argv[1:]))"
    )
    arguments = ["--map", "map.yaml", "--input", "table.csv", "--output", "bag"]
    environment = {**os.environ, "LOCPATH": str(tmp_path), "LC_ALL": "de_DE.UTF-8"}
    said = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=tmp_path,
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    assert "heater_current 0.0015 to 0.0025 A" in said
    recording, _ = read_recording(tmp_path / "bag")
    assert recording["heater_current"].tolist() == [1.5e-3, 2.5e-3]
