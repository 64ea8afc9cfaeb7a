"""The model file: written whole or not at all, and read with one clear line where it cannot be."""

import os

import pytest
from vo2_models.model_file import load_model_parameters, save_model_parameters

MODEL = {
    "model.device": "integrated",
    "model.thermal.time_constant": 1.8e-3,
    "model.resistance.radii": [0.0, 1.5],
}


def test_what_is_written_is_read(tmp_path):
    path = tmp_path / "new folder" / "model.yaml"
    save_model_parameters(path, MODEL, comment="fitted to a bag")
    assert load_model_parameters(path) == MODEL
    assert path.read_text().startswith("# fitted to a bag\n")
    assert os.listdir(path.parent) == ["model.yaml"]


@pytest.mark.parametrize("failure", [OSError("disk full"), KeyboardInterrupt()])
def test_a_failure_while_writing_leaves_the_former_file_and_nothing_beside_it(tmp_path, monkeypatch, failure):
    path = tmp_path / "model.yaml"
    save_model_parameters(path, MODEL)

    def fail(*_arguments):
        raise failure

    monkeypatch.setattr("vo2_models.io.files.os.replace", fail)
    with pytest.raises(type(failure)):
        save_model_parameters(path, {"model.device": "peltier"})
    assert load_model_parameters(path) == MODEL
    assert os.listdir(tmp_path) == ["model.yaml"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "cannot be read"),
        (b"PK\x03\x04\x80\xff", "byte 4 is not UTF-8"),
        (b"a: [1\nb: }", "is not YAML"),
        (b"", "holds no model"),
        (b"/**:\n  ros__parameters:\n", "holds no model"),
        (b"/**:\n  ros__parameters: {kind: composite}\n", "holds no model"),
        (b"/**: {ros__parameters: {model.a: }}", "model.a: found None"),
        (b"/**: {ros__parameters: {model: {a: .nan}}}", "model.a: found nan"),
        (b"/**: {ros__parameters: {model.a: [1, b]}}", "model.a: found"),
        (b"/**: {ros__parameters: {model.a: [[1], [2]]}}", "model.a: found"),
        (b"/**: {ros__parameters: {model.a: 99999999999999999999}}", "model.a: found"),
        (b"/**: {ros__parameters: {model.a: 2020-01-01}}", "model.a: found"),
        (b"/**: {ros__parameters: " + b"[" * 100_000, "nested deeper"),
    ],
)
def test_what_is_no_model_file_is_one_line_that_names_it(tmp_path, content, said):
    path = tmp_path / "model.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=said) as caught:
        load_model_parameters(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and "`fit`" in text


@pytest.mark.parametrize(("name", "value"), [("device", "x"), ("model.gain", float("nan"))])
def test_what_cannot_stand_in_a_model_file_is_refused(tmp_path, name, value):
    with pytest.raises(ValueError, match=name):
        save_model_parameters(tmp_path / "model.yaml", {name: value})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("share", [0.2, 0.5, 0.99])
def test_a_file_that_was_cut_off_is_told(tmp_path, share):
    values = {f"model.thermal.t{k}": float(k) for k in range(40)}
    save_model_parameters(tmp_path / "model.yaml", values, comment="fitted")
    assert load_model_parameters(tmp_path / "model.yaml") == values
    lines = (tmp_path / "model.yaml").read_text().splitlines(keepends=True)
    (tmp_path / "half.yaml").write_text("".join(lines[: int(share * len(lines))]))
    with pytest.raises(
        ValueError, match=r"half\.yaml: is cut off, its end is missing; give a file that `fit` wrote"
    ):
        load_model_parameters(tmp_path / "half.yaml")
    # one without the mark, of an earlier version or by hand, is taken as it is
    (tmp_path / "old.yaml").write_text("/**:\n  ros__parameters:\n    model.device: integrated\n")
    assert load_model_parameters(tmp_path / "old.yaml") == {"model.device": "integrated"}
