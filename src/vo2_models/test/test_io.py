"""Reading and writing files: limits of the YAML reader, whole files, folders that a person uses too."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time

import pytest
from vo2_models.io import InputError, OutputFolder, load_yaml, one_line, read_yaml, write_whole

BOMB = "a: &a [x,x,x,x,x,x,x,x,x,x]\n" + "\n".join(
    f"{name}: &{name} [{','.join(['*' + before] * 10)}]"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
MAPPING_BOMB = "a: &a {k: 1, l: 2}\n" + "\n".join(
    f"{name}: &{name} {{<<: [{','.join(['*' + before] * 10)}], {name}: 1}}"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 100_000, "line 1: found lists or mappings nested deeper than 32"),
        ("\n".join(" " * k + "a:" for k in range(1000)), "line 33: found lists or mappings nested"),
        ("- " * 100_000, "nested deeper"),
        (BOMB, "line 5: found more than 100000 values"),
        (MAPPING_BOMB, "found more than 100000 values"),
        ("a: &a [*a]", "an alias to 'a', which is not complete"),
        ("a: *nothing", "an alias to 'nothing'"),
        ("a: !!python/object/apply:os.system [ls]", "the tag"),
        ("a: !!binary x", "the tag"),
        ("a: 2020-99-99", "quote it"),
        ("a: " + "9" * 5000, "quote it"),
        ("a: " + "1:1" * 5000, "15000 characters without quotes"),
        ("a: b\n---\nc: d", "is not YAML"),
        ("{[a]: b}", "is not YAML"),
        (b"\xff\xfe", "byte 0 is not UTF-8"),
        (b"a: \x00", "is not YAML"),
        (b"a" * (1 << 24) + b"a", "16.7772 MB of YAML"),
    ],
)
def test_hostile_yaml_is_refused_at_once_in_one_line(text, said):
    began = time.process_time()
    with pytest.raises(InputError, match=said) as caught:
        load_yaml(text, "given.yaml")
    assert time.process_time() - began < 5.0
    message = str(caught.value)
    assert message.startswith("given.yaml: ") and message.isprintable() and len(message) < 700


def test_ordinary_yaml_with_aliases_is_read():
    assert load_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2.5}\n", "here") == {
        "a": {"x": 1},
        "b": {"x": 1, "y": 2.5},
    }
    assert load_yaml(b"\xef\xbb\xbfa: b", "here") == {"a": "b"}
    assert load_yaml("", "here") is None


def test_a_fifo_a_folder_and_a_device_are_not_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    for path, kind in ((tmp_path / "fifo", "a FIFO"), (tmp_path, "a folder"), ("/dev/zero", "a device file")):
        with pytest.raises(InputError, match=f"found {kind}, need a regular file"):
            read_yaml(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_yaml(tmp_path / "none")


def test_messages_are_one_printable_line_whatever_they_quote():
    said = one_line("found '" + "\x1b[31m\n" * 10_000 + "'")
    assert said.isprintable() and len(said) <= 600 and said.endswith("'")


def test_a_full_disk_leaves_the_former_file_nothing_beside_it_and_names_it(tmp_path):
    path = tmp_path / "report.html"
    write_whole(path, "before")

    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    code = (
        "import signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from vo2_models.io import write_whole\n"
        "try: write_whole(sys.argv[1], 'x' * 100000)\n"
        "except OSError as error: print(error.filename)\n"
    )
    said = subprocess.run(
        [sys.executable, "-B", "-c", code, path],
        preexec_fn=small_disk,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert said.strip() == str(path)
    assert path.read_text() == "before"
    assert os.listdir(tmp_path) == ["report.html"]


NAMES = ("bag", "report.html")


def write_outputs(folder):
    (folder / "bag").mkdir()
    (folder / "bag" / "bag_0.mcap").write_bytes(b"samples")
    (folder / "report.html").write_text("report")


def test_own_outputs_are_replaced_again_and_again(tmp_path):
    for _ in range(3):
        with OutputFolder(tmp_path, NAMES).replaced() as folder:
            assert not (folder / "bag").exists()
            write_outputs(folder)


def a_folder(folder):
    (folder / "bag").mkdir()


def a_link(folder):
    (folder / "elsewhere").mkdir()
    (folder / "bag").symlink_to(folder / "elsewhere")


def a_file(folder):
    (folder / "report.html").write_text("mine")


@pytest.mark.parametrize("place", [a_folder, a_link, a_file])
def test_what_somebody_else_put_there_is_refused_and_stays(tmp_path, place):
    place(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with (
        pytest.raises(InputError, match="is not an output of this program"),
        OutputFolder(tmp_path, NAMES).replaced(),
    ):
        pytest.fail("the folder was given away")
    assert sorted(tmp_path.rglob("*")) == before


def add(folder):
    (folder / "bag" / "notes.txt").write_text("mine")


def add_a_folder(folder):
    (folder / "bag" / "mine").mkdir()


def edit(folder):
    (folder / "report.html").write_text("report, edited by hand")


def replace_by_own(folder):
    shutil.rmtree(folder / "bag")
    (folder / "bag").write_text("mine")


def damage_list(folder):
    (folder / ".vo2_outputs.json").write_text("[" * 100_000)


@pytest.mark.parametrize("change", [add, add_a_folder, edit, replace_by_own, damage_list])
def test_outputs_that_somebody_has_changed_since_stay(tmp_path, change):
    with OutputFolder(tmp_path, NAMES).replaced() as folder:
        write_outputs(folder)
    change(tmp_path)
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    with pytest.raises(InputError, match="move it away or choose another output folder"):
        OutputFolder(tmp_path, NAMES).clear()
    assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == before


def test_a_failed_run_is_remembered_and_other_commands_keep_their_lists(tmp_path):
    with OutputFolder(tmp_path, ["other.json"]).replaced() as folder:
        (folder / "other.json").write_text("{}")
    with pytest.raises(KeyboardInterrupt), OutputFolder(tmp_path, NAMES).replaced() as folder:
        write_outputs(folder)
        raise KeyboardInterrupt
    OutputFolder(tmp_path, NAMES).clear()
    assert sorted(os.listdir(tmp_path)) == [".vo2_outputs.json", "other.json"]
    OutputFolder(tmp_path, ["other.json"]).clear()
    assert os.listdir(tmp_path) == [".vo2_outputs.json"]
