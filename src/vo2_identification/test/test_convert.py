"""`convert`: tables of any rig, and the measured recordings of other people."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from openpyxl import Workbook
from vo2_identification.bags import read_recording
from vo2_identification.bags.problems import Problem, in_few_lines
from vo2_identification.conversion.column_map import MapError, read_map
from vo2_identification.conversion.converting import convert_file

from vo2_identification import convert

MEASURED = Path(__file__).resolve().parents[4] / "shared" / "data"
measured = pytest.mark.skipif(
    not MEASURED.is_dir(),
    reason="the measured recordings are not there: need ../shared/data beside the repository",
)

MAP = """
device: rig
header_row: 1
time: {column: t, unit: ms}
channels:
  heater_current: {column: I, unit: mA}
  film_resistance: {column: R, unit: kohm}
  stage_temperature: {column: T, unit: K}
"""
BACK = "".join(f"-{k},3,30,302\n" for k in range(1, 13))
TABLE = "t,I,R,T\n0,1,10,300\n1,2,20,301\n2,3,30,302\n"


def prepared(tmp_path, *, text=MAP, table=TABLE, encoding="utf-8", name="table.csv"):
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    (tmp_path / name).write_bytes(table.encode(encoding))
    return tmp_path / name, tmp_path / "map.yaml"


def converted(tmp_path, **options):
    table, path = prepared(tmp_path, **options)
    (one,) = convert_file(table, read_map(path))
    return one


def expect_the_table(recording):
    np.testing.assert_array_equal(recording.time_s, [0.0, 1e-3, 2e-3])
    np.testing.assert_allclose(recording["heater_current"], [1e-3, 2e-3, 3e-3], rtol=1e-15)
    np.testing.assert_allclose(recording["film_resistance"], [1e4, 2e4, 3e4], rtol=1e-15)
    np.testing.assert_allclose(recording["stage_temperature"], [26.85, 27.85, 28.85], rtol=1e-12)
    assert recording.device == "rig"


@pytest.mark.parametrize(
    ("table", "encoding", "extra"),
    [
        (TABLE, "utf-8", ""),
        ("\ufeff" + TABLE, "utf-8", ""),
        (TABLE.replace("\n", "\r\n"), "utf-8", ""),
        (TABLE, "utf-16", "encoding: utf-16\n"),
        (TABLE.replace(",", ";").replace("10", "10,0"), "utf-8", 'delimiter: ";"\ndecimal: ","\n'),
        (TABLE.replace(",", "\t"), "utf-8", "delimiter: tab\n"),
        (TABLE.replace(",", "   "), "utf-8", "delimiter: whitespace\n"),
        ("R,t,T,I\n10,0,300,1\n20,1,301,2\n30,2,302,3\n", "utf-8", ""),
        (TABLE + "\n\n", "utf-8", ""),
        ('"t","I","R","T"\n' + TABLE.split("\n", 1)[1], "utf-8", ""),
    ],
)
def test_the_same_table_in_many_dialects(tmp_path, table, encoding, extra):
    one = converted(tmp_path, text=MAP + extra, table=table, encoding=encoding)
    assert one.problems == []
    expect_the_table(one.recording)


def test_column_names_in_a_windows_encoding(tmp_path):
    text = MAP.replace("column: T", "column: Tµ") + "encoding: cp1252\n"
    expect_the_table(
        converted(tmp_path, text=text, table=TABLE.replace("T", "Tµ"), encoding="cp1252").recording
    )


def test_columns_by_number_rows_in_bounds_and_a_sampling_rate(tmp_path):
    text = """
first_row: 3
last_row: 5
time: {rate_hz: 4}
channels: {tip_deflection: {column: 2, unit: um, scale: -2, offset: 10}}
"""
    one = converted(tmp_path, text=text, table="made by,hand\n,\n0,1\n0,2\n0,3\nend,end\n")
    np.testing.assert_array_equal(one.recording.time_s, [0.0, 0.25, 0.5])
    np.testing.assert_allclose(one.recording["tip_deflection"], [8e-6, 6e-6, 4e-6], rtol=1e-15)


def test_xlsx_sheets_with_several_series_side_by_side(tmp_path):
    book = Workbook()
    book.active.title = "empty"
    sheet = book.create_sheet("runs")
    for row in [["t", "R", "t", "R"], [0, 10, 0, 5], [0.5, 20, 0.1, 6], [None, None, 0.2, 7]]:
        sheet.append(row)
    book.save(tmp_path / "runs.xlsx")
    text = """
format: xlsx
sheet: runs
first_row: 2
series:
  a: {time: {column: 1, unit: s}, channels: {film_resistance: {column: 2, unit: ohm}}}
  b: {time: {column: 3, unit: s}, channels: {film_resistance: {column: 4, unit: ohm}}}
"""
    (tmp_path / "map.yaml").write_text(text)
    a, b = convert_file(tmp_path / "runs.xlsx", read_map(tmp_path / "map.yaml"))
    assert (a.name, b.name) == ("runs_a", "runs_b")
    assert a.problems == b.problems == []
    np.testing.assert_array_equal(a.recording["film_resistance"], [10, 20])
    np.testing.assert_array_equal(b.recording.time_s, [0, 0.1, 0.2])
    (only,) = convert_file(tmp_path / "runs.xlsx", read_map(tmp_path / "map.yaml"), only="b")
    assert only.name == "runs_b"
    with pytest.raises(MapError, match=r"no series 'c'.*a, b"):
        convert_file(tmp_path / "runs.xlsx", read_map(tmp_path / "map.yaml"), only="c")


def test_missing_values_stay_as_nan_and_are_reported_by_row(tmp_path):
    one = converted(
        tmp_path, table="t,I,R,T\n0,1,10,300\n1,2,,301\n,9,9,9\n2,3,n/a,302\n5,4,40,303\n6,4,40,303\n"
    )
    np.testing.assert_array_equal(
        np.isnan(one.recording["film_resistance"]), [False, True, True, False, False]
    )
    np.testing.assert_array_equal(one.recording.time_s, [0.0, 1e-3, 2e-3, 5e-3, 6e-3])
    assert [(problem.kind, problem.text.split(":")[0]) for problem in one.problems] == [
        ("malformed", "row 4 has no time and is left out"),
        ("nan", "row 3"),
        ("nan", "row 5"),
        ("gap", "row 5"),
    ]


def test_a_rig_without_a_device_file_has_names_and_units_of_its_own(tmp_path):
    one = converted(
        tmp_path,
        text=MAP.replace("stage_temperature", "room")
        .replace("film_resistance", "clamp_force")
        .replace("kohm", "kN"),
    )
    np.testing.assert_allclose(one.recording["clamp_force"], [1e4, 2e4, 3e4], rtol=1e-12)
    np.testing.assert_allclose(one.recording["room"], [26.85, 27.85, 28.85], rtol=1e-12)


def test_the_command_prints_the_units_of_a_rig_without_a_device_file(tmp_path, capsys):
    text = MAP.replace("stage_temperature", "room").replace("film_resistance", "coil_flux")
    file, path = prepared(tmp_path, text=text.replace("kohm", "mWb"))
    assert convert.main(["--map", str(path), "--input", str(file), "--output", str(tmp_path / "bag")]) == 0
    said = capsys.readouterr().out
    assert "coil_flux 0.01 to 0.03 Wb, room 26.85 to 28.85 degC). The bag" in said


@pytest.mark.parametrize("end", ["3,4,4", "3,", "3"])
def test_a_last_row_that_was_not_written_to_its_end_is_left_out_and_told(tmp_path, end):
    one = converted(tmp_path, table=TABLE + end)
    expect_the_table(one.recording)
    assert [(problem.kind, problem.text) for problem in one.problems] == [
        ("truncated", "row 5, the last, ends before its last column and is left out")
    ]


def test_a_clock_that_jumps_back_is_named_by_row(tmp_path):
    table = "t,I,R,T\n" + "".join(f"{t},1,10,300\n" for t in [*range(10), 4, *range(10, 20)])
    one = converted(tmp_path, table=table)
    assert len(one.recording) == 20
    assert [(problem.kind, problem.text[:6]) for problem in one.problems] == [("non_monotonic", "row 12")]


def test_a_stretch_without_values_is_one_problem_and_the_infinite_is_no_value(tmp_path):
    cells = ["10", "inf", "", "", "40", "nan"]
    one = converted(tmp_path, table="t,I,R,T\n" + "".join(f"{k},1,{r},300\n" for k, r in enumerate(cells)))
    np.testing.assert_array_equal(
        np.isnan(one.recording["film_resistance"]), [False, True, True, True, False, True]
    )
    assert [problem.text for problem in one.problems] == [
        "rows 3 to 5: film_resistance is infinite, kept as NaN",
        "row 7: film_resistance has no value, kept as NaN",
    ]


def test_a_scale_that_makes_values_infinite_is_told_by_rows(tmp_path):
    text = MAP.replace("unit: kohm", "unit: kohm, scale: 1.0e308")
    assert [problem.text for problem in converted(tmp_path, text=text).problems] == [
        "rows 2 to 4: film_resistance is infinite, kept as NaN"
    ]


def test_rows_that_repeat_are_counted(tmp_path):
    one = converted(tmp_path, table=TABLE + 2 * "2,3,30,302\n")
    expect_the_table(one.recording)
    assert [problem.kind for problem in one.problems] == ["repeat"]
    assert one.problems[0].text.startswith("2 rows repeat")


@pytest.mark.parametrize("unit", ["kohm", "kOhm", "k\N{GREEK CAPITAL LETTER OMEGA}", "k\N{OHM SIGN}"])
def test_spellings_of_a_unit(tmp_path, unit):
    expect_the_table(converted(tmp_path, text=MAP.replace("unit: kohm", f"unit: {unit}")).recording)


@pytest.mark.parametrize("unit", ["um", "\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m"])
def test_spellings_of_micro(tmp_path, unit):
    text = f"time: {{rate_hz: 1}}\nchannels: {{tip_deflection: {{column: 1, unit: {unit}}}}}\n"
    assert converted(tmp_path, text=text, table="5\n").recording["tip_deflection"][0] == pytest.approx(5e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ("unit: mA", "unit: A"),
            r"heater_current runs from 1 to 8 A.*\(off by a factor of 1 000, in the values or in the map\?\)",
        ),
        (("unit: kohm", "unit: ohm"), r"film_resistance runs from 12 to 200 ohm.*\(is it in kohm\?\)"),
        (("column: 2, unit: kohm", "column: 1, unit: kohm"), "film_resistance is a copy of heater_current"),
        (
            ("unit: mA", "unit: uA"),
            r"heater_current varies by 7e-06 A .*check its unit \(off by a factor of 1 000, ",
        ),
        (
            ("unit: um", "unit: m"),
            r"tip_deflection runs from 1 to 50 m.*\(off by a factor of 1 000 000, in the values or in the map\?\)",
        ),
        (("unit: degC", "unit: degF"), None),
        (("", ""), None),
    ],
)
def test_a_wrong_unit_is_noticed(tmp_path, capsys, change, said):
    text = """
device: integrated
time: {rate_hz: 100}
channels:
  heater_current: {column: 1, unit: mA}
  film_resistance: {column: 2, unit: kohm}
  tip_deflection: {column: 3, unit: um}
  ambient_temperature: {column: 4, unit: degC}
"""
    table, path = prepared(tmp_path, text=text.replace(*change), table="1,200,1,20\n4,90,25,20\n8,12,50,20\n")
    command = ["--map", str(path), "--input", str(table), "--output", str(tmp_path / "bag")]
    assert convert.main(command) == 0
    error = capsys.readouterr().err
    assert re.search(said, error) if said else error == ""


def test_stamps_that_occur_more_than_once_are_told_as_such(tmp_path):
    rows = "".join(f"{k // 2},{k},30,302\n" for k in range(40))
    with pytest.raises(
        MapError, match=r"20 of 40 rows have the time of the row before with other .*row 3 \(0 s\); need"
    ):
        converted(tmp_path, table=f"t,I,R,T\n{rows}")


def test_a_bad_file_of_a_folder_does_not_cost_the_others(tmp_path, capsys):
    prepared(tmp_path)
    prepared(tmp_path, name="a_bad_one.csv", table="nothing\n1\n")
    command = ["--map", str(tmp_path / "map.yaml"), "--input", str(tmp_path)]
    assert convert.main([*command, "--output", str(tmp_path / "bags")]) == 2
    printed = capsys.readouterr()
    assert "1 of 2 files" in printed.err and "a_bad_one.csv: found no column" in printed.err
    expect_the_table(read_recording(tmp_path / "bags" / "table")[0])


def test_interrupting_is_one_line(tmp_path, capsys, monkeypatch):
    table, path = prepared(tmp_path)

    def interrupt(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("vo2_identification.bags.write_bag", interrupt)
    command = ["--map", str(path), "--input", str(table), "--output", str(tmp_path / "bag")]
    assert convert.main(command) == 130
    assert capsys.readouterr().err.splitlines() == [
        "convert: interrupted; the bags named so far are complete"
    ]


def test_many_problems_are_told_in_few_lines():
    found = [Problem("gap", "t", f"gap {k}", time_s=float(k)) for k in range(20)]
    found += [Problem("more", "t", "30 more of kind gap"), Problem("nan", "t", "no value")]
    lines = in_few_lines(found, most=2)
    assert [line.text for line in lines] == ["gap 0", "gap 1", "no value", "48 more gaps"]


def test_a_guard_blanks_what_means_nothing(tmp_path):
    text = MAP.replace("unit: kohm}", "unit: kohm, valid_where: {channel: heater_current, at_least: 1.5e-3}}")
    one = converted(tmp_path, text=text)
    np.testing.assert_array_equal(np.isnan(one.recording["film_resistance"]), [True, False, False])
    assert [problem.kind for problem in one.problems] == ["nan"]


def test_a_share_of_another_column_is_taken_off(tmp_path):
    """A known load, a lead's voltage, a tare: in SI units, missing where either has no value."""
    text = MAP.replace("unit: kohm}", "unit: kohm, less: {column: T, unit: K, factor: 20}}")
    one = converted(tmp_path, text=text, table=TABLE.replace("20,301", "20,"))
    celsius = np.array([26.85, np.nan, 28.85])
    np.testing.assert_allclose(one.recording["film_resistance"], [1e4, 2e4, 3e4] - 20 * celsius, rtol=1e-12)
    assert {problem.kind for problem in one.problems} == {"nan"}


@pytest.mark.parametrize(
    ("change", "table", "named"),
    [
        (
            ("unit: kohm", "unit: kohm, less: {column: T, unit: K}"),
            TABLE,
            "less: factor: found nan, need a finite",
        ),
        (
            ("unit: kohm", "unit: kohm, less: {column: T, factor: 2}"),
            TABLE,
            "less: unit: found None, which is not known; need one of",
        ),
        (("unit: kohm", "unit: kohm, less: {column: P, unit: bar, factor: 2}"), TABLE, r"no column 'P'"),
        (("column: R", "column: Rho"), TABLE, r"column 'Rho'.*'t', 'I', 'R', 'T'"),
        (("", ""), TABLE.replace("20", "2o"), r"table\.csv: row 3, column 'R': found '2o', need a number"),
        (
            ("column: I", "column: R"),
            "t,R,R,T\n1,2,3,4\n",
            r"'R' occurs 2 times; use one of its numbers 2, 3",
        ),
        (("", ""), "t,R,R,T\n1,2,3,4\n", r"no column 'I'"),
        (("unit: kohm", "unit: kPa"), TABLE, "channel film_resistance: unit: found 'kPa'.*kohm"),
        (("unit: kohm", "unit: mA"), TABLE, "need a unit of resistance"),
        (
            ("film_resistance: {column: R, unit: kohm", "flux: {column: R, unit: Webr"),
            TABLE,
            r"channel flux: unit: found 'Webr', which is not known; need one of m, .*Wb.* with k, .*p before it",
        ),
        (("film_resistance", "resistance"), TABLE, "channel resistance: not a channel.*film_resistance"),
        (("header_row: 1", "header_rows: 1"), TABLE, "'header_rows', which means nothing here"),
        (("header_row: 1", "header_row: one"), TABLE, "header_row: found 'one', need int"),
        (("header_row: 1", "header_row: 9"), TABLE, "found 4 rows, need a header in row 9"),
        (("unit: ms", "unit: mm"), TABLE, "time: unit: found 'mm'"),
        (("{column: t, unit: ms}", "{rate_hz: 0}"), TABLE, "rate_hz: found 0"),
        (("{column: t, unit: ms}", "{}"), TABLE, "need either a column"),
        (("device: rig", "delimiter: ;;"), TABLE, "delimiter: found ';;'"),
        (("device: rig", "encoding: klingon"), TABLE, "encoding: found 'klingon'"),
        (("device: rig", "encoding: ascii"), TABLE.replace("R", "Ω"), "byte 4 is not ascii"),
        (("device: rig", "format: xlsx"), TABLE, "not an .xlsx workbook"),
        (("channels:", "channel:"), TABLE, "'channel', which means nothing"),
        (("column: R,", "column: 7,"), TABLE, "found 4 columns, need a column 7"),
        (("", ""), "t,I,R,T\n", "need samples from row 2 on"),
        (("unit: kohm", "unit: kOmh"), TABLE, r"found 'kOmh'.*did you mean kohm\?"),
        (("", ""), TABLE.replace(",", ";"), 'set delimiter: ";" in the map'),
        (("header_row: 1", "header_row: 2"), "rig 7,,,\n\n" + TABLE, "stands in row 3: set header_row: 3"),
        (("device: rig", "delimiter: ;"), "t;I;R;T\n0;1,5;2;3\n", "found '1,5'.*set decimal: \",\""),
        (
            ("", ""),
            TABLE.replace("0,1,10", "ms,mA,kohm,K\n0,1,10"),
            "row 2, .*: found '.*set first_row: 3 in the",
        ),
        (("", ""), "PK\x03\x04\x80", "found an .xlsx workbook.*format: xlsx"),
        (
            ("", ""),
            "t,I,R,T\n3,1,10,300\n2,2,20,301\n1,3,30,302\n0,3,30,302\n" + BACK,
            "16 rows only 1 would be",
        ),
        (
            ("", ""),
            "t,I,R,T\n" + "".join(f"5,{k},10,300\n" for k in range(30)),
            "5 s in row 2 to 0.005 s in row",
        ),
        (("", ""), "t,I,R,T\n" + ",1,10,300\n" * 3, "no row has a time"),
        (
            ("unit: ms", "unit: s"),
            "t,I,R,T\n1732180000000,1,10,300\n1732180000001,1,10,300\n",
            "time of 1.73",
        ),
        (
            ("", ""),
            "t,I,R,T\n0,0,1,5,10,2,300,1\n1,0,2,5,20,2,301,1\n",
            "row 2: found 8 cells under a header of 4: commas that separate and decimal ones",
        ),
        (
            ("", ""),
            TABLE.replace("1,2,20,301", "1,2,5,20,301"),
            "row 3: found 5 cells under a header of 4, as in 1 of 3 rows: a separator too many",
        ),
    ],
)
def test_what_cannot_be_used_is_one_line_with_its_place(tmp_path, capsys, change, table, named):
    file, path = prepared(tmp_path, text=MAP.replace(*change), table=table)
    with pytest.raises(MapError, match=named):
        convert_file(file, read_map(path))
    command = ["--map", str(path), "--input", str(file), "--output", str(tmp_path / "bag")]
    assert convert.main(command) == 2
    said = capsys.readouterr().err
    assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_the_command_makes_a_bag_and_says_where(tmp_path, capsys, storage):
    file, path = prepared(tmp_path)
    command = [
        "--map",
        str(path),
        "--input",
        str(file),
        "--output",
        str(tmp_path / "bag"),
        "--storage",
        storage,
    ]
    assert convert.main(command) == 0
    assert "3 samples over 0.002 s (heater_current 0.001 to 0.003 A, film" in capsys.readouterr().out
    recording, _ = read_recording(tmp_path / "bag")
    expect_the_table(recording)
    assert convert.main(command) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_folder_becomes_a_bag_per_file(tmp_path, capsys):
    prepared(tmp_path)
    prepared(tmp_path, name="other.csv")
    command = [
        "--map",
        str(tmp_path / "map.yaml"),
        "--input",
        str(tmp_path),
        "--output",
        str(tmp_path / "bags"),
    ]
    assert convert.main(command) == 0
    assert sorted(one.name for one in (tmp_path / "bags").iterdir()) == ["other", "table"]
    assert convert.main([*command[:3], str(tmp_path / "bags"), *command[4:]]) == 2
    assert "found no file *.csv" in capsys.readouterr().err


def test_help_and_list_name_the_shipped_maps(capsys):
    with pytest.raises(SystemExit, match="0"):
        convert.main(["--help"])
    assert convert.main(["--list"]) == 0
    said = capsys.readouterr().out
    for name in ("vo2_device_sweep", "vo2_device_pulses", "vo2_device_relaxation_slow", "piezo"):
        assert f"{name}: " in said
    assert convert.main(["--map", "nonsense", "--input", "x", "--output", "y"]) == 2
    assert "piezo" in capsys.readouterr().err


@settings(max_examples=40, deadline=None)
@given(
    cells=st.lists(st.floats(-1e12, 1e12), min_size=1, max_size=30),
    scale=st.floats(-1e3, 1e3).filter(lambda x: abs(x) > 1e-3),
    offset=st.floats(-1e3, 1e3),
)
def test_scale_and_offset_act_before_the_unit(tmp_path_factory, cells, scale, offset):
    folder = tmp_path_factory.mktemp("any")
    text = (
        f"time: {{rate_hz: 10}}\nchannels: {{tip_deflection: {{column: 1, unit: um, scale: {scale!r}, "
        f"offset: {offset!r}}}}}\n"
    )
    one = converted(folder, text=text, table="".join(f"{cell!r}\n" for cell in cells))
    expected = (scale * np.array(cells) + offset) * 1e-6
    np.testing.assert_allclose(one.recording["tip_deflection"], expected, rtol=1e-12, atol=1e-25)


@measured
def test_the_measured_sweep_is_what_the_instrument_wrote():
    maps = convert.shipped_maps()
    file = MEASURED / "vo2_device" / "VO2_data_RvsV_transition.csv"
    (one,) = convert_file(file, read_map(maps["vo2_device_sweep"]))
    raw = np.loadtxt(file, delimiter=",", skiprows=35, encoding="utf-8-sig")
    assert len(one.recording) == 419
    np.testing.assert_allclose(one.recording.time_s, raw[:, 1], atol=1e-9)
    np.testing.assert_array_equal(one.recording["heater_voltage"], raw[:, 2])
    np.testing.assert_array_equal(one.recording["heater_current"], raw[:, 3])
    np.testing.assert_array_equal(one.recording["film_resistance"], raw[:, 4])
    # the instrument's resistance is its voltage over its current: the columns are the right ones
    np.testing.assert_allclose(raw[:, 2] / raw[:, 3], raw[:, 4], rtol=0.02)
    # the autoranging pauses of the instrument are said
    gaps = [problem for problem in one.problems if problem.kind == "gap"]
    assert len(gaps) == len(one.problems) == 6
    assert gaps[0].text.startswith("row 39: 1.47818 s")


@measured
def test_the_measured_pulses_are_read_in_both_orders_of_their_columns():
    column_map = read_map(convert.shipped_maps()["vo2_device_pulses"])
    files = sorted((MEASURED / "vo2_device" / "short_pulses").glob(column_map.files))
    assert len(files) == 6
    for file in files:
        (one,) = convert_file(file, column_map)
        recording = one.recording
        assert recording["heater_voltage"].max() == pytest.approx(float(file.name.split("V")[0]), abs=0.01)
        valid = ~np.isnan(recording["film_resistance"])
        assert 4 <= np.count_nonzero(~valid) <= 5
        quotient = recording["heater_voltage"][valid] / recording["heater_current"][valid]
        np.testing.assert_allclose(recording["film_resistance"][valid], quotient, rtol=2e-3)
        assert [problem.kind for problem in one.problems] == ["nan"]


@measured
@pytest.mark.parametrize(
    ("sheet", "series", "samples", "first_ohm"),
    [
        ("slow", "pulse_10mA", 1101, 8693.28093),
        ("fast", "pulse_20mA", 1001, 24407.18761),
        ("ultraslow", "pulse_0.1s", 10101, 12026.86586),
    ],
)
def test_the_measured_relaxations_are_read_by_series(sheet, series, samples, first_ohm):
    column_map = read_map(convert.shipped_maps()[f"vo2_device_relaxation_{sheet}"])
    (one,) = convert_file(MEASURED / "vo2_device" / "relaxation_timescales.xlsx", column_map, only=series)
    assert len(one.recording) == samples
    assert one.recording["film_resistance"][0] == first_ohm
    assert one.problems == []


@measured
def test_the_measured_piezo_becomes_a_bag(tmp_path, capsys):
    command = ["--map", "piezo", "--input", str(MEASURED / "piezo"), "--output", str(tmp_path / "bag")]
    assert convert.main(command) == 0
    recording, _ = read_recording(tmp_path / "bag")
    raw = np.loadtxt(MEASURED / "piezo" / "Model_Vi_Do.dat")
    np.testing.assert_array_equal(recording["heater_voltage"], raw[:, 0])
    np.testing.assert_allclose(recording["tip_deflection"], raw[:, 4] * 1e-6, rtol=1e-15)
    np.testing.assert_allclose(recording.time_s, np.arange(8027) / 200, atol=1e-9)
    assert recording.device == "piezo"
