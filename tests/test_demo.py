"""The main job as a user calls it: every act once, and the loops a second time, to the bit."""

import json
import subprocess
import sys

import pytest
from test_lockstep import contents

SEED = 3
TOPICS = [
    f"{space}/{name}"
    for space in ("/vo2", "/polynomial")
    for name in ("measurement", "command", "estimate", "reference")
]


def demo(folder, *options):
    """Run the demo; what it printed."""
    command = [sys.executable, "-m", "vo2_studies.demo", "--output", str(folder), "--seed", str(SEED)]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_demo_ends_with_a_report_and_repeats_bit_for_bit(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    printed = demo(first, "--effect", "latent_heat")
    assert f"--seed {SEED}" in printed and str(first / "report.html") in printed
    assert (first / "report.html").stat().st_size > 100_000
    metrics = json.loads((first / "metrics.json").read_text())
    assert metrics["replay"]["equal"] and metrics["replay"]["samples"] > 9000
    assert metrics["diagnosis"]["effects"] == ["latent_heat"]
    assert metrics["composite"]["random_mae_percent"] < 1.0
    demo(second, "--acts", "loops", "identification", "random_levels", "tracking", "bag")
    again = json.loads((second / "metrics.json").read_text())
    assert (first / "model.yaml").read_bytes() == (second / "model.yaml").read_bytes()
    for scheme in ("composite", "polynomial"):
        assert again[scheme] == metrics[scheme]
    one, two = (contents(folder / "bag") for folder in (first, second))
    for topic in TOPICS:
        assert len(one[topic]) > 9000, topic
        assert one[topic] == two[topic], topic
