"""Malformed input for every reader: sound files, mutated in their bytes and in their structure.

A case is a number: the same number makes the same input. `survive` is what every reader must do with it.
"""

from __future__ import annotations

import contextlib
import io
import random
import re
import shutil
import signal
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from bag_makers import bag_by_rosbags, measurements
from openpyxl import Workbook
from vo2_identification.bags import read_recording
from vo2_identification.bags.playback import outline, schedule
from vo2_models.device import description
from vo2_models.effects import catalogue
from vo2_models.io import InputError
from vo2_models.model_file import load_model_parameters, save_model_parameters

from vo2_identification import convert

__all__ = ["READERS", "Hang", "survive"]

_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_LONGEST_CPU_S = 5.0
_LONGEST_WALL_S = 120  # a reader that waits: the machine may be busy
_NUMBERS = (0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)
_TEXTS = (
    b"\0",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"../",
    b"\r",
    b"\n",
    b'"',
    b"'",
    b",",
    b";",
    b"\t",
    b"nan",
    b"1e999",
)
_MARKS = (
    b"[",
    b"]",
    b"{",
    b"}",
    b": ",
    b"- ",
    b"&a ",
    b"*a",
    b"!!binary ",
    b"? ",
    b"|\n",
    b"%",
    b"<<: ",
    b"---\n",
)
_WORDS = (b"None", b"0", b"-1", b"1e999", b"''", b"[]", b"{}", b"()", b"lambda", b"object()", b"print", b"x")
_VALUES: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    10**30,
    float("nan"),
    float("inf"),
    -1e308,
    1e-320,
    "",
    "../../outside",
    "/etc/passwd",
    "x" * 3000,
    "\u202e\x1b[31m",
    [],
    {},
    [[1, [2]]],
    {"a": {"b": []}},
    [None],
    ["1", 2],
)
MAP = {
    "description": "rig",
    "device": "integrated",
    "header_row": 1,
    "time": {"column": "t", "unit": "ms"},
    "channels": {
        "heater_current": {"column": "I", "unit": "mA"},
        "film_resistance": {"column": 3, "unit": "kohm", "scale": 2.0, "offset": 1},
        "tip_deflection": {
            "column": 4,
            "unit": "um",
            "valid_where": {"channel": "heater_current", "at_least": 0.0},
        },
    },
}
SERIES = {
    "format": "csv",
    "delimiter": ",",
    "encoding": "utf-8",
    "decimal": ".",
    "first_row": 2,
    "last_row": 9,
    "missing": ["", "nan"],
    "time": {"rate_hz": 100.0},
    "series": {
        "one": {"channels": {"heater_current": {"column": 2, "unit": "mA"}}},
        "two": {
            "time": {"column": 1, "unit": "s"},
            "channels": {"film_resistance": {"column": 3, "unit": "ohm"}},
        },
    },
}
ROWS = [["t", "I", "R", "x"], *[[k, 4.0 + 0.1 * k, 100.0 - k, 2.0] for k in range(12)]]
TABLE = "".join(",".join(map(str, row)) + "\n" for row in ROWS).encode()
MODEL = {
    "model.device": "integrated",
    "model.thermal.time_constant": 1.8e-3,
    "model.thermal.ambient": 22.0,
    "model.resistance.radii": [0.0, 1.5, 2.5],
    "model.kinds": ["a", "b"],
}


class Hang(BaseException):
    """A reader took too long; not an `Exception`, so that no reader can take it for a fault of its input."""


def survive(call: Callable[[], object]) -> bool:
    """Call a reader: it takes its input or refuses it in one line, in time; return whether it took it.

    Raises
    ------
    Hang : more than 5 s of processor time, or 120 s of waiting.
    Exception : whatever else it lets out.
    """

    def ring(number: int, frame: object) -> None:
        raise Hang

    before = {number: signal.signal(number, ring) for number in (signal.SIGPROF, signal.SIGALRM)}
    signal.setitimer(signal.ITIMER_PROF, _LONGEST_CPU_S)
    signal.alarm(_LONGEST_WALL_S)
    try:
        call()
    except InputError as error:
        message = str(error)
        if not (message and message.isprintable() and len(message) <= 600):
            raise AssertionError(f"no line for people: {message!r}") from error
        return False
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        for number, handler in before.items():
            signal.signal(number, handler)
    return True


def mutated(data: bytes, chance: random.Random, pieces: tuple[bytes, ...] = _TEXTS) -> bytes:
    """Return the bytes with one to four mutations: flipped, cut, doubled, overwritten by numbers or texts."""
    found = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        place = chance.randrange(len(found) + 1)
        stop = min(len(found), place + int(chance.expovariate(1 / 16)))
        match chance.randrange(8):
            case 0 if found:
                found[min(place, len(found) - 1)] ^= 1 << chance.randrange(8)
            case 1:
                del found[place:stop]
            case 2:
                found[place:place] = found[place:stop] * chance.choice((1, 2, 200))
            case 3:
                number = chance.choice(_NUMBERS)
                kind = chance.choice("BHIQ")
                size = struct.calcsize(kind)
                found[place : place + size] = struct.pack(f"<{kind}", number & ((1 << 8 * size) - 1))
            case 4:
                found[place:stop] = chance.randbytes(stop - place)
            case 5:
                found[place:place] = chance.choice(pieces) * chance.choice((1, 1, 1, 50, 5000))
            case 6:
                other = chance.randrange(len(found) + 1)
                found[place:stop] = found[other : other + stop - place]
            case _:
                del found[place:]
    return bytes(found)


def mutated_tree(tree: Any, chance: random.Random) -> Any:
    """Return the document with some values replaced, keys changed, or parts moved."""
    if chance.random() < 0.15:
        return chance.choice(_VALUES)
    if isinstance(tree, dict):
        changed = {
            key: mutated_tree(value, chance) if chance.random() < 0.4 else value
            for key, value in tree.items()
        }
        if changed and chance.random() < 0.15:
            changed[chance.choice(_VALUES[:14])] = changed.pop(chance.choice(list(changed)))
        return changed
    if isinstance(tree, list):
        return [
            mutated_tree(value, chance) if chance.random() < 0.4 else value for value in tree
        ] * chance.choice((1, 1, 1, 0, 3))
    return chance.choice(_VALUES)


def _dump(tree: Any, *, flow: bool | None = None) -> bytes:
    return yaml.dump(tree, Dumper=_DUMPER, sort_keys=False, default_flow_style=flow).encode()


def mutated_yaml(tree: Any, chance: random.Random) -> bytes:
    """Return a YAML text of the document, mutated as a tree, as a text, or both."""
    if chance.random() < 0.6:
        tree = mutated_tree(tree, chance)
    text = _dump(tree, flow=chance.choice((None, True)))
    return mutated(text, chance, _MARKS) if chance.random() < 0.6 else text


class _Bags:
    """Bags of both storages and all compressions, mutated in a storage file or in metadata.yaml."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        samples = measurements(12) + measurements(6, topic="/vo2/command")
        forms = [(storage, "NONE") for storage in ("mcap", "sqlite3")]
        forms += [("mcap", "STORAGE"), ("mcap", "MESSAGE"), ("mcap", "FILE"), ("sqlite3", "MESSAGE")]
        self.bags = []
        for number, (storage, compression) in enumerate(forms):
            bag = bag_by_rosbags(
                folder / f"bag{number}",
                samples,
                storage=storage,
                compression=compression,
                chunk=7 * (storage == "mcap"),
            )
            (file,) = (each for each in bag.iterdir() if each.name != "metadata.yaml")
            metadata = bag / "metadata.yaml"
            text = metadata.read_bytes()
            self.bags.append((file, file.read_bytes(), metadata, text, yaml.safe_load(text)))

    def __call__(self, chance: random.Random) -> None:
        file, content, metadata, text, tree = self.bags[min(int(chance.expovariate(0.5)), len(self.bags) - 1)]
        described = chance.random() < 0.2
        file.write_bytes(content if described else mutated(content, chance))
        metadata.write_bytes(mutated_yaml(tree, chance) if described else text)
        if chance.random() < 0.8:
            read_recording(file.parent)
        else:
            list(schedule(file, outline(file), passes=2))


class _Models:
    """Model files."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "model.yaml"
        save_model_parameters(self.file, MODEL)
        self.tree = yaml.safe_load(self.file.read_text())

    def __call__(self, chance: random.Random) -> None:
        self.file.write_bytes(mutated_yaml(self.tree, chance))
        load_model_parameters(self.file)


class _Devices:
    """Device files."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "device.yaml"
        shipped = Path(description.__file__).parent / "files"
        self.trees = [yaml.safe_load(each.read_text()) for each in sorted(shipped.glob("*.yaml"))]

    def __call__(self, chance: random.Random) -> None:
        self.file.write_bytes(mutated_yaml(chance.choice(self.trees), chance))
        description.preset(self.file)


class _Effects:
    """Effect files: Python that is executed, where a slip of the user must be told in a line with the file's name."""

    def __init__(self, folder: Path) -> None:
        shipped = Path(catalogue.__file__).parent
        self.folder = folder / "effects"
        self.folder.mkdir()
        self.files = [
            (each.name, each.read_bytes())
            for each in sorted(shipped.glob("*.py"))
            if b"EFFECT = Effect(" in each.read_bytes()
        ]

    def __call__(self, chance: random.Random) -> None:
        name, content = chance.choice(self.files)
        content = _mutated_tokens(content, chance) if chance.random() < 0.7 else mutated(content, chance)
        file = self.folder / name
        file.write_bytes(content)
        try:
            record = catalogue.load_effect(catalogue.module_of(file))
            if chance.random() < 0.05:  # takes a tenth of a second
                catalogue.check_hooks(record)
        except ValueError as error:
            if str(file) not in str(error):
                raise AssertionError(f"does not say in which file: {error}") from error
            raise InputError(str(error)) from error
        finally:
            file.unlink()


def _mutated_tokens(source: bytes, chance: random.Random) -> bytes:
    """Return Python that mostly still compiles: names, numbers and texts of it changed, dropped or exchanged."""
    words = re.split(rb"(\w+)", source)
    for _ in range(chance.randint(1, 3)):
        place = 1 + 2 * chance.randrange(len(words) // 2)
        other = 1 + 2 * chance.randrange(len(words) // 2)
        words[place] = chance.choice((words[other], *_WORDS))
    return b"".join(words)


class _Tables:
    """The command `convert`, with a mutated map or table; checks that nothing is written outside its output."""

    def __init__(self, folder: Path, form: str) -> None:
        self.folder, self.form = folder / "tables", form
        self.folder.mkdir()
        self.sound = _workbook() if form == "xlsx" else TABLE

    def __call__(self, chance: random.Random) -> None:
        table, path = self.folder / f"table.{self.form}", self.folder / "map.yaml"
        tree = chance.choice((MAP, SERIES)) | {"format": self.form}
        if self.form == "map":
            table = table.with_suffix(".csv")
            tree |= {"format": "csv"}
        mutated_table = self.form != "map"
        table.write_bytes(_mutated_table(self.sound, self.form, chance) if mutated_table else self.sound)
        path.write_bytes(_dump(tree) if mutated_table else mutated_yaml(tree, chance))
        output = self.folder / "out" / "bag"
        said = io.StringIO()
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            status = convert.main(["--map", str(path), "--input", str(table), "--output", str(output)])
        lines = said.getvalue().splitlines()
        shutil.rmtree(output.parent, ignore_errors=True)
        strangers = [each for each in self.folder.parent.rglob("*") if each not in (self.folder, table, path)]
        if strangers:
            raise AssertionError(f"written outside the output: {strangers}")
        if not all(
            line.startswith("convert: ") and line.isprintable() and len(line) < 1000 for line in lines
        ):
            raise AssertionError(f"no lines for people: {lines}")
        if status not in (0, 2) or ((status == 2) != any(lines) and status == 2):
            raise AssertionError(f"status {status} with {lines}")
        if status == 2:
            raise InputError(lines[-1])


def _workbook() -> bytes:
    book = Workbook()
    for row in ROWS:
        book.active.append(row)
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def _mutated_table(sound: bytes, form: str, chance: random.Random) -> bytes:
    if form != "xlsx":
        return mutated(sound, chance)
    if chance.random() < 0.3:
        return mutated(sound, chance)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(sound)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        names = old.namelist()
        # the sheet first of all
        chosen = "xl/worksheets/sheet1.xml" if chance.random() < 0.6 else chance.choice(names)
        for name in names:
            content = old.read(name)
            if name == chosen:
                pieces = (
                    b"<row>",
                    b"<c r='XFD1048576'/>",
                    b"</row>",
                    b"<v>",
                    b"&lt;",
                    b"&x;",
                    b"<!--",
                    b" r='A9999999'",
                )
                content = mutated(content, chance, pieces)
            if name != chosen or chance.random() < 0.97:
                new.writestr(name, content)
    return out.getvalue()


READERS: dict[str, Callable[[Path], Callable[[random.Random], None]]] = {
    "bags": _Bags,
    "models": _Models,
    "devices": _Devices,
    "effects": _Effects,
    "csv": lambda folder: _Tables(folder, "csv"),
    "xlsx": lambda folder: _Tables(folder, "xlsx"),
    "maps": lambda folder: _Tables(folder, "map"),
}
"""Name -> maker of a function that writes the malformed input of a case into a folder of its own and reads it."""
