"""Commands with --output: what they did not write themselves stays, and they say so before they begin."""

from __future__ import annotations

import pytest
from vo2_identification.bags import write_bag
from vo2_identification.diagnose import main as diagnose
from vo2_identification.fit import main as fit
from vo2_models.recording import Recording
from vo2_studies.challenge.command import main as challenge
from vo2_studies.demo.__main__ import main as demo
from vo2_studies.measured.command import main as measured
from vo2_studies.reproduce.command import run as reproduce


def users_files(folder, names):
    """Put a folder or file of a person under each name; return path -> content."""
    for name in names:
        if "." in name:
            (folder / name).write_text("mine")
        else:
            (folder / name).mkdir()
            (folder / name / "notes.txt").write_text("mine")
    return contents(folder)


def contents(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.mark.parametrize(
    ("command", "options", "name"),
    [
        *((demo, [], name) for name in ("bag", "diagnosis", "logs", "model.yaml", "report.html", "measured")),
        (demo, ["--seeds", "1"], "seeds.json"),
        *(
            (challenge, ["--cases", "1", "--seed", "1"], name)
            for name in ("cases", "answers", "challenge.html")
        ),
        *((reproduce, ["--only", "8.4"], name) for name in ("reproduction.html", "scenarios")),
        *(
            (diagnose, ["--bag", "none", "--model", "none"], name)
            for name in ("report.html", "diagnosis.json")
        ),
        (measured, ["--data", "{folder}", "--only", "piezo"], "bags"),
    ],
)
def test_a_persons_own_files_survive_and_the_command_is_refused(tmp_path, capsys, command, options, name):
    from vo2_studies.measured.sources import SOURCES

    place = tmp_path / "mine"
    place.mkdir()
    (tmp_path / SOURCES["piezo"].file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / SOURCES["piezo"].file).touch()
    before = users_files(place, [name, "other.txt"])
    given = [option.format(folder=tmp_path) for option in options]
    assert command([*given, "--output", str(place)]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert str(place / name) in said[0] and "move it away or choose another output folder" in said[0]
    assert contents(place) == before


def test_fit_replaces_model_files_of_its_own_only(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", Recording([0.0, 1.0], {"heater_current": [0.0, 0.0]}, "integrated"))
    for text in ("my notes", "/**: {ros__parameters: {model.a: 1}}"):
        (tmp_path / "model.yaml").write_text(text)
        arguments = ["--bag", str(bag), "--device", "integrated", "--output", str(tmp_path / "model.yaml")]
        assert fit(arguments) == 2
        assert "model.yaml: exists and was not fitted by `fit`" in capsys.readouterr().err
        assert (tmp_path / "model.yaml").read_text() == text
