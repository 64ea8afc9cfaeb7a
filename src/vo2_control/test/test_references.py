"""Set-points: the contract's signals, tables from files, bad input."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vo2_control.references import Multisine, Steps, Table, read_table, reference_signal


@pytest.mark.parametrize(
    ("signal", "time_s", "um"),
    [
        ("steps", 0.0, 20.0),
        ("steps", 0.9995, 20.0),
        ("steps", 1.0, 35.0),
        ("steps", 4.5, 42.0),
        ("steps", 99.0, 42.0),
        ("sine", 2.5, 45.0),
        ("sine", 7.5, 15.0),
        ("multisine", 0.025, 30 + 4 * math.sin(0.05 * math.pi) - 6),
    ],
)
def test_signals_of_the_integrated_device(signal, time_s, um):
    assert reference_signal("integrated", signal).at(time_s) * 1e6 == pytest.approx(um, abs=1e-9)


def test_multisine_of_the_peltier_device():
    assert reference_signal("peltier", "multisine").at(25.0) * 1e6 == pytest.approx(
        35 + 8 * math.sin(0.05 * math.pi) + 7 * math.sin(0.25 * math.pi) + 5 * math.sin(0.5 * math.pi)
    )


@given(st.integers(0, 4), st.integers(0, 999))
def test_a_step_starts_with_the_sample_of_its_time_whatever_the_rounding(level, sample):
    steps = reference_signal("integrated", "steps")
    assert steps.at((level * 1000 + sample) * 1_000_000 * 1e-9) == steps.levels_m[level]


@pytest.mark.parametrize("name", ["triangle", "sine"])
def test_an_unknown_signal_is_refused_with_those_there_are(name):
    with pytest.raises(ValueError, match=r"for device peltier, need steps, multisine, steps\.levels_m"):
        reference_signal("peltier", name)


def test_a_device_of_a_file_has_no_signals_but_those_that_are_given(tmp_path):
    device = tmp_path / "rig.yaml"
    device.write_text(
        "schema: vo2-device/1\nid: rig\ndrive: {channel: volts, unit: V, limits: [0, 150], operating: [0, 100]}\n"
        "body: {kind: none}\nresponses: {stroke: {unit: m}}\n"
    )
    with pytest.raises(ValueError, match=r"found 'steps' for device rig, need steps\.levels_m, multisine"):
        reference_signal(str(device), "steps")


@pytest.mark.parametrize(
    "make",
    [
        lambda: Steps((), 1.0),
        lambda: Steps((1e-6,), 0.0),
        lambda: Multisine(0.0, (1e-6,), (1.0, 2.0), 1.0),
        lambda: Multisine(0.0, (float("nan"),), (1.0,), 1.0),
        lambda: Table((0.0, 0.0), (1.0, 2.0)),
        lambda: Table((0.0, 1.0), (1.0,)),
    ],
)
def test_signals_that_make_no_sense_are_refused(make):
    with pytest.raises(ValueError, match="need"):
        make()


def test_a_table_interpolates_and_holds_its_ends(tmp_path):
    path = tmp_path / "reference.csv"
    path.write_text("time_s,tip_deflection,remark\n1,1e-5,a\n2,3e-5,b\n")
    table = read_table(path)
    assert [table.at(t) for t in (0.0, 1.5, 9.0)] == pytest.approx([1e-5, 2e-5, 3e-5])


@pytest.mark.parametrize(
    ("text", "found"),
    [("t,x\n1,2\n", "has t, x"), ("time_s,tip_deflection\n1,abc\n", "line 2: found 'abc'"), ("", "no row")],
)
def test_a_bad_table_is_refused_with_the_place(tmp_path, text, found):
    path = tmp_path / "reference.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match="need") as caught:
        read_table(path)
    assert found in str(caught.value)


def test_a_missing_table_is_named():
    with pytest.raises(ValueError, match=r"nowhere\.csv cannot be read"):
        read_table("nowhere.csv")
