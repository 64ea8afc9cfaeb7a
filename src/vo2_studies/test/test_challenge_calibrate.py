"""The calibration of probabilities: each family by the others, and what the printed table counts."""

import json

import numpy as np
import pytest
from vo2_studies.challenge.calibrate import Explained, calibrated, left_out, main, reliability

TRUE = (5.0, 4.0, 2.5)


def cases(families=("a", "b", "c"), *, each=60, seed=3) -> list[Explained]:
    """Explanations that are wrong the more often the less surely they act and the more they leave."""
    rng = np.random.default_rng(seed)
    found = []
    for family in families:
        for sure, left in rng.uniform(0.0, 2.5, (each, 2)):
            odds = TRUE[0] - TRUE[1] * sure + TRUE[2] * left
            wrong = rng.random() < 1.0 / (1.0 + np.exp(-odds))
            found.append(Explained(family, sure, left, not wrong))
    return found


def test_the_coefficients_are_those_the_cases_were_drawn_with() -> None:
    assert calibrated(cases(each=1500)) == pytest.approx(np.array(TRUE), rel=0.15)


def test_a_family_has_no_say_in_its_own_probabilities() -> None:
    good = cases()
    spoiled = [c if c.family != "a" else Explained("a", c.sure, c.left, not c.right) for c in good]
    own = np.array([c.family == "a" for c in good])
    assert np.allclose(left_out(good)[own], left_out(spoiled)[own])
    assert not np.allclose(left_out(good)[~own], left_out(spoiled)[~own])


def test_probabilities_of_families_left_out_are_reliable() -> None:
    drawn = cases(each=300)
    probability, right = left_out(drawn), np.array([c.right for c in drawn])
    for low, high in ((0.0, 0.5), (0.5, 0.9), (0.9, 1.0)):
        own = (probability >= low) & (probability < high)
        assert np.mean(right[own]) == pytest.approx(np.mean(probability[own]), abs=0.06)
    lines = reliability(probability, right)
    assert sum(int(line.split("n ")[1].split()[0]) for line in lines) == len(drawn)


def test_a_folder_without_explanations_is_refused(tmp_path, capsys) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "answers").mkdir()
    (tmp_path / "results" / "0000.json").write_text(json.dumps({"failure": "fit: broke", "diagnosis": None}))
    (tmp_path / "answers" / "0000.json").write_text("{}")
    assert main([str(tmp_path)]) == 2
    assert "found no case with an explanation" in capsys.readouterr().err
