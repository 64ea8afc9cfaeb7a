"""What all commands do alike: one line for bad input; a bar on a terminal, lines elsewhere."""

import os
import pty
import subprocess
import sys

import pytest
from vo2_models.command_line import Progress, duration, refuse


def test_bad_input_is_one_line_and_status_2(capsys):
    assert refuse("fit", ValueError("model:\n found nothing")) == 2
    assert capsys.readouterr().err == "fit: model: found nothing\n"


@pytest.mark.parametrize(("seconds", "words"), [(12.2, "12 s"), (600.0, "10 min"), (9000.0, "2.5 h")])
def test_a_duration_has_its_natural_unit(seconds, words):
    assert duration(seconds) == words


def test_where_there_is_no_terminal_there_are_lines(capsys):
    with Progress("fit") as progress:
        progress(None, "reading")
        progress(0.5, "loops")
        progress(1.0, "done")
    first, second, third = capsys.readouterr().err.splitlines()
    assert (first, third) == ("fit: reading", "fit: 100 %  done")
    assert second == "fit:  50 %  loops, about 0 s left"


def test_lines_come_not_too_often_and_not_where_they_are_not_wanted(capsys):
    often = Progress("fit", every_s=60.0)
    for share in (0.1, 0.2, 1.0):
        often(share, "loops")
    assert len(capsys.readouterr().err.splitlines()) == 2
    Progress("fit", quiet=True)(0.5, "loops")
    Progress("diagnose", lines=False)(0.5, "loops")
    Progress("diagnose", every_s=60.0, first_s=60.0)(0.5, "loops")
    assert capsys.readouterr().err == ""


def test_on_a_terminal_there_is_one_bar_that_goes_away():
    code = (
        "import sys; from vo2_models.command_line import Progress\n"
        "with Progress('fit') as p: p(0.25, 'loops'); p(None, 'reading')\n"
        "print('after', file=sys.stderr)"
    )
    ours, theirs = pty.openpty()
    try:
        subprocess.run([sys.executable, "-c", code], stderr=theirs, check=True, timeout=60)
        shown = os.read(ours, 10_000).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    assert " 25 % |" in shown and "loops, about" in shown and "reading" in shown
    assert "\n" not in shown.partition("after")[0]
    assert shown.rpartition("\r")[0].rstrip().endswith("after")
