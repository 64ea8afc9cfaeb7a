"""The benchmark of diagnosis time: found by name, fails aloud, and times real processes (slow)."""

import pytest
from vo2_studies.bench import diagnosis as bench_diagnosis
from vo2_studies.bench import runner


def test_it_is_found_by_the_names_of_its_entries():
    assert set(runner.entries()) >= {entry.name for entry in bench_diagnosis.ENTRIES}
    known = {entry.name: entry for entry in bench_diagnosis.ENTRIES}
    assert runner.select(known, []) == []  # minutes: on request only
    assert [entry.name for entry in runner.select(known, ["diagnosis_40k"])] == ["diagnosis_40k"]
    targets = {entry.name: (entry.target, entry.of, entry.above) for entry in bench_diagnosis.ENTRIES}
    assert targets == {"diagnosis_10k": (20.0, "value", False), "diagnosis_40k": (120.0, "value", False)}


def test_a_process_that_fails_is_no_short_time(tmp_path):
    with pytest.raises(RuntimeError, match=r"fit: exit 2: .*nowhere"):
        bench_diagnosis._run(
            "fit", "--bag", "nowhere", "--device", "integrated", "--output", "model.yaml", folder=tmp_path
        )


@pytest.mark.slow
def test_lengths_are_timed_in_order():
    short, long = bench_diagnosis.diagnosis_seconds("none", [1, 3])
    assert 1.0 < short < long
