"""Every reader on malformed input: it takes it or refuses it in one line, within 5 s and bounded memory.

The short form runs always; 100 000 inputs with `./vo2 test --all`.
"""

from __future__ import annotations

import random
import resource
from collections.abc import Callable

import pytest
from fuzzing import READERS, Hang, survive
from hypothesis import given, settings
from hypothesis import strategies as st
from vo2_identification.bags import read_recording
from vo2_models.io import InputError, load_yaml

_MOST_MB = 1500


def attack(folder, name: str, first: int, count: int) -> int:
    """Let a reader read so many malformed inputs; return how many of them it took."""
    read = READERS[name](folder)
    taken = 0
    for number in range(first, first + count):
        try:
            taken += survive(lambda: read(random.Random(number)))  # noqa: B023  # called at once
        except (Exception, Hang) as error:
            raise AssertionError(
                f"{name}, case {number}: {type(error).__name__}: {str(error)[:500]}"
            ) from error
    return taken


pytestmark = pytest.mark.filterwarnings("ignore::SyntaxWarning")  # what Python says of a mutated effect file


@pytest.mark.parametrize("name", READERS)
def test_malformed_input_is_survived(tmp_path, name):
    taken = attack(tmp_path, name, 0, 60)
    assert 0 < taken < 60  # the mutations neither leave everything sound nor damage everything


SHARES = {
    "bags": 20_000,
    "models": 18_000,
    "devices": 14_000,
    "effects": 10_000,
    "csv": 14_000,
    "maps": 14_000,
    "xlsx": 10_000,
}
"""Inputs of the long form: together 100 000."""


@pytest.mark.slow
@pytest.mark.parametrize("name", SHARES)
def test_100_000_malformed_inputs_are_survived(tmp_path, capsys, name):
    taken = attack(tmp_path, name, 1_000_000, SHARES[name])
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    with capsys.disabled():
        print(
            f"\nmalformed {name}: {SHARES[name]} survived, {taken} taken, {SHARES[name] - taken} refused in one line; "
            f"memory {peak_mb:.0f} MB at most"
        )
    assert peak_mb < _MOST_MB


scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20)
documents = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(scalars, inner, max_size=4),
    max_leaves=30,
)


def refused_in_a_line(call: Callable[[], object]) -> None:
    try:
        call()
    except InputError as error:
        assert str(error).isprintable() and 0 < len(str(error)) <= 600


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=200) | st.binary(max_size=200) | st.text("[]{}&*!:-? \n'\"|>%@ab0", max_size=60))
def test_any_text_is_yaml_or_refused(text):
    refused_in_a_line(lambda: load_yaml(text, "given"))


@settings(max_examples=100, deadline=None)
@given(
    content=st.binary(max_size=300),
    storage=st.sampled_from([(".mcap", b"\x89MCAP0\r\n"), (".db3", b"SQLite format 3\0")]),
)
def test_any_bytes_are_a_bag_or_refused(tmp_path_factory, content, storage):
    ending, magic = storage
    file = tmp_path_factory.getbasetemp() / f"any_0{ending}"
    for data in (content, magic + content):
        file.write_bytes(data)
        refused_in_a_line(lambda: read_recording(file))


@settings(max_examples=50, deadline=None)
@given(documents)
def test_any_document_is_a_device_file_a_model_a_map_or_refused(tmp_path_factory, document):
    import yaml
    from vo2_identification.conversion.column_map import read_map
    from vo2_models.device.description import preset
    from vo2_models.model_file import load_model_parameters

    file = tmp_path_factory.getbasetemp() / "any.yaml"
    file.write_text(yaml.safe_dump(document))
    for read in (read_map, load_model_parameters, preset):
        try:
            read(file)
        except ValueError as error:
            assert str(file) in str(error)
