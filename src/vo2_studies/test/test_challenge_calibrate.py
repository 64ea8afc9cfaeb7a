"""The calibration of probabilities: each family by the others, and what the printed table counts."""

import json

import numpy as np
import pytest
from vo2_studies.challenge.calibrate import Named, calibrated, left_out, main, reliability_of_names


def cases(families=("a", "b", "c"), *, each=60, steep=4.0, seed=3) -> list[Named]:
    """Names that are wrong the more often the more is predictable."""
    rng = np.random.default_rng(seed)
    found = []
    for family in families:
        for predictable in 10.0 ** rng.uniform(-3, -0.5, each):
            odds = steep * (np.log10(predictable + 0.003) + 1.4)
            wrong = rng.random() < 1.0 / (1.0 + np.exp(-odds))
            found.append(Named(family, 0.9, float(predictable), not wrong))
    return found


def test_the_coefficients_are_those_the_cases_were_drawn_with() -> None:
    base, by_open, by_left = calibrated(cases(each=600))
    assert by_open == pytest.approx(4.0, rel=0.2)
    assert base + 0.1 * by_left == pytest.approx(5.6, rel=0.2)


def test_a_family_has_no_say_in_its_own_probabilities() -> None:
    good = cases()
    spoiled = [c if c.family != "a" else Named("a", c.explained, c.predictable, not c.right) for c in good]
    own = np.array([c.family == "a" for c in good])
    assert np.allclose(left_out(good)[own], left_out(spoiled)[own])
    assert not np.allclose(left_out(good)[~own], left_out(spoiled)[~own])


def test_probabilities_of_families_left_out_are_reliable() -> None:
    drawn = cases(each=300)
    probability, right = left_out(drawn), np.array([c.right for c in drawn])
    for low, high in ((0.0, 0.5), (0.5, 0.9), (0.9, 1.0)):
        own = (probability >= low) & (probability < high)
        assert np.mean(right[own]) == pytest.approx(np.mean(probability[own]), abs=0.06)
    lines = reliability_of_names(probability, right)
    assert sum(int(line.split("n ")[1].split()[0]) for line in lines) == len(drawn)


def test_a_folder_without_names_is_refused(tmp_path, capsys) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "answers").mkdir()
    (tmp_path / "results" / "0000.json").write_text(json.dumps({"failure": "fit: broke", "diagnosis": None}))
    (tmp_path / "answers" / "0000.json").write_text("{}")
    assert main([str(tmp_path)]) == 2
    assert "found no named case" in capsys.readouterr().err
