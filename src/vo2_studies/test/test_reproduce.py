"""The reproduction's framework: rules, files, refusals; and that its sections are what they claim to be."""

import json
import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from vo2_control.pid import PUBLISHED_PELTIER_PID, pid_law
from vo2_studies.reproduce import main
from vo2_studies.reproduce.claims import Claim, Context, Section, at_least, at_most, within
from vo2_studies.reproduce.command import section_modules
from vo2_studies.reproduce.own_designs import Designs
from vo2_studies.reproduce.page import page
from vo2_studies.reproduce.peltier import EXPERIMENTS, NOISE_A, PERIOD_S, current_noise, reference
from vo2_studies.reproduce.pool import run_many
from vo2_studies.reproduce.sections import chapter_6, chapter_8_own, chapter_8_robustness

KEYS = {"id", "section", "claim", "published", "ours", "unit", "met"}


@pytest.mark.parametrize(
    ("rule", "met", "not_met"),
    [(within(2.0, 0.1), 2.19, 2.21), (at_most(1.0), 1.0, 1.01), (at_least(1.0), 1.0, 0.99)],
)
def test_rules(rule, met, not_met):
    assert Claim("a", "8", "x", 2.0, met, "1", rule).met
    assert not Claim("a", "8", "x", 2.0, not_met, "1", rule).met
    assert not Claim("a", "8", "x", 2.0, math.nan, "1", rule).met


def test_record_has_the_agreed_keys_and_plain_values():
    record = Claim("a", "8", "x", None, np.float64(1.0), "1", at_most(2.0)).record()
    assert set(record) >= KEYS
    assert json.loads(json.dumps(record))["met"] is True
    assert Claim("a", "8", "x", None, math.inf, "1", at_most(2.0)).record()["ours"] is None


def test_page_escapes_and_says_what_is_not_met():
    claims = (Claim("a", "8", "<script>", 1.0, 3.0, "1", at_most(2.0)),)
    text = page([Section("8", "T", claims)], command="x", seconds=1.0)
    assert (
        "&lt;script&gt;" in text
        and "<script>" not in text
        and "not met" in text
        and "0 of 1 claims met" in text
    )


def test_one_section_end_to_end(tmp_path, capsys):
    assert main(["--only", "8.3", "--output", str(tmp_path)]) == 0
    records = json.loads((tmp_path / "reproduction.json").read_text())
    assert records and all(set(r) >= KEYS and r["section"].startswith("8.3") for r in records)
    assert {r["id"]: r["met"] for r in records}["8.3.gamma"]
    text = (tmp_path / "reproduction.html").read_text()
    assert text.count("<svg") == 2 and "--only 8.3" in text
    assert "claims met" in capsys.readouterr().out


def test_bad_arguments_end_with_one_line(tmp_path, capsys):
    assert main(["--only", "99", "--output", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("reproduce: --only: found 99, need one of") and len(said.splitlines()) == 1
    blocked = tmp_path / "file"
    blocked.write_text("")
    assert main(["--only", "8.3", "--output", str(blocked / "x")]) == 2
    assert "that may be written into" in capsys.readouterr().err
    assert main(["--draws", "0"]) == 2


def test_sections_are_complete_and_unique():
    modules = section_modules()
    numbers = [m.NUMBER for m in modules]
    assert len(set(numbers)) == len(numbers) and all(m.TITLE and callable(m.run) for m in modules)


def test_references_and_noise_are_those_of_the_experiments():
    steps, settle = reference("steps")
    assert sorted(set(np.round(1e6 * steps[settle:]))) == [20, 35, 50] and steps.size - settle == 360
    multi, settle = reference("multi")
    assert multi.size - settle == 8000 and multi[settle] == pytest.approx(35e-6)
    assert 1e6 * np.abs(multi[settle:] - 35e-6).max() <= 20
    noise = current_noise(8000, 1)
    assert 0.4 * NOISE_A < noise.std() < 0.7 * NOISE_A
    power = np.abs(np.fft.rfft(noise)) ** 2
    assert power[3600:].mean() < 0.1 * power[:2800].mean()  # band-limited


def _interrupted(arguments, wait_for, by=signal.SIGINT):
    """Start python in a group of its own, press Ctrl-C once it has said `wait_for`; return status and what it said."""
    process = subprocess.Popen(
        [sys.executable, "-u", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    said = ""
    assert process.stderr is not None
    for line in process.stderr:
        said += line
        if wait_for in line:
            os.killpg(process.pid, by) if by == signal.SIGINT else process.send_signal(by)
            break
    said += process.stderr.read()
    return process.wait(timeout=120), said


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_keeps_the_sections_that_are_done(tmp_path, by):
    arguments = [
        "-m",
        "vo2_studies.reproduce",
        "--only",
        "8.3",
        "--only",
        "8.4",
        "--output",
        str(tmp_path),
    ]
    status, said = _interrupted([*arguments, "--draws", "50"], "8.4    ", by)
    assert status == 130 and "interrupted in 8.4" in said and "Traceback" not in said
    assert {r["section"][:3] for r in json.loads((tmp_path / "reproduction.json").read_text())} == {"8.3"}


def test_interrupt_ends_the_processes_of_a_pool_quietly():
    program = (
        "import sys, time\n"
        "from vo2_studies.reproduce.pool import run_many\n"
        "if __name__ == '__main__':\n"
        "    try:\n"
        "        run_many(time.sleep, [0.1] + [60.0] * 7, 2, lambda n: print('one', n, file=sys.stderr))\n"
        "    except KeyboardInterrupt:\n"
        "        sys.exit(130)\n"
    )
    started = time.monotonic()
    status, said = _interrupted(["-c", program], "one 1")
    assert status == 130 and "Traceback" not in said and time.monotonic() - started < 30


def test_pool_keeps_the_order_whatever_the_number_of_processes():
    jobs = list(range(20))
    assert run_many(abs, jobs, 1, lambda n: None) == run_many(abs, jobs, 2, lambda n: None) == jobs


def _module(number):
    return next(m for m in section_modules() if number == m.NUMBER)


@pytest.mark.parametrize(
    "number",
    ["3.6", *(pytest.param(n, marks=pytest.mark.slow) for n in ("2.4", "3.5", "4.3", "4.4", "5", "6"))],
)
def test_open_loop_sections_find_a_value_for_every_claim(number):
    section = _module(number).run(Context())
    ids = [claim.id for claim in section.claims]
    assert len(set(ids)) == len(ids)
    assert all(math.isfinite(claim.ours) for claim in section.claims)
    assert all(claim.section.startswith(number.split(".")[0]) for claim in section.claims)
    assert section.figures and all(figure.svg.startswith("<svg") for figure in section.figures)


def test_iterations_of_the_fixed_point_inverse_follow_the_tolerance():
    """6.4.1 on its own model: fewer iterations than published at both tolerances, and fewer at the coarser one."""
    claims = {claim.id: claim for claim in chapter_6._iterations(7)[0]}
    fine, coarse = claims["6.4.1.iterations_0.0001"], claims["6.4.1.iterations_0.01"]
    assert fine.met and coarse.met and coarse.ours < fine.ours


def test_own_comparison_runs_every_loop_and_judges_by_the_reference():
    law = pid_law(PUBLISHED_PELTIER_PID, PERIOD_S)
    designs = Designs(law, law, law, law, 0.5, {}, ())
    found = chapter_8_own.compare((designs, 3, True))
    assert set(found.merits) == {(kind, name) for kind in EXPERIMENTS for name in chapter_8_own.LOOPS}
    for kind in EXPERIMENTS:
        # the same law and sensing: what differs is the feedforward alone
        assert found.merits[kind, "PID"].rmse_um == found.merits[kind, "H-infinity alone"].rmse_um
        assert found.merits[kind, "PID + feedforward"].rmse_um == found.merits[kind, "H-infinity"].rmse_um
    # feedforward that crosses the loop ahead tracks better than the published PID by itself
    assert found.merits["multi", "H-infinity"].rmse_um < found.merits["multi", "PID"].rmse_um
    assert set(found.traces) == set(chapter_8_own.LOOPS)
    survival = chapter_8_robustness.survive((designs, 3))
    assert survival.finite and abs(survival.factor - 1) <= 0.2 and 0.5 <= survival.noise <= 2.0
