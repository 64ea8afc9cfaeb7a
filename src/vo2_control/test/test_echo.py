"""Whether the plant follows: from the measured current alone, for any driver."""

import math

import pytest
from vo2_control.echo import CommandEcho

MS = 1_000_000


def play(commands, measured):
    """Command and measure in turn: the current of each sample is what the plant made of the command before."""
    echo = CommandEcho(0.0, 0.012)
    for k, (command, current) in enumerate(zip(commands, measured, strict=True)):
        echo.command(k * MS, command)
        echo.measure((k + 1) * MS, current)
    return echo


def test_a_plant_at_the_safe_current_does_not_follow_until_it_moves():
    echo = play([0.004] * 5, [0.0] * 5)
    assert not echo.followed
    echo.measure(6 * MS, 0.0039)
    assert echo.followed


def test_a_loop_that_ran_opens_where_none_of_the_last_three_commands_flows():
    assert not play([0.006] * 6, [0.006] * 5 + [0.0]).followed
    # late by two periods, or told to go there
    assert play([0.0, 0.0, 0.006, 0.006], [0.0] * 4).followed
    assert not play([0.0, 0.0, 0.006, 0.006, 0.006], [0.0] * 5).followed
    assert play([0.006, 0.006, 0.0, 0.0], [0.006, 0.006, 0.0, 0.0]).followed


@pytest.mark.parametrize(
    "driver", [lambda i: 0.8 * i, lambda i: min(i, 0.005), lambda i: i + 3e-4, lambda _: math.nan]
)
def test_a_driver_with_errors_of_its_own_is_followed_and_not_behind(driver):
    commands = [0.004 + 3e-4 * k for k in range(12)]
    echo = play(commands, [driver(i) for i in commands])
    assert echo.followed
    assert driver(0.012) == 0.005 or not echo.behind


def test_a_command_that_came_late_is_seen():
    commands = [0.004, 0.0045, 0.005]
    assert play(commands, [0.004, 0.0045, 0.0045]).behind
    assert not play(commands, commands).behind


def test_only_what_the_plant_does_after_a_restart_counts():
    echo = play([0.004] * 3, [0.004] * 3)
    echo.restart()
    echo.command(3 * MS, 0.004)
    echo.measure(3 * MS, 0.004)
    assert not echo.followed


def test_a_current_that_stays_far_from_all_commands_is_astray_and_one_on_its_way_is_not():
    stuck = play([0.004] * 12, [0.004, *[0.012] * 11])
    assert stuck.astray == 0.012 and stuck.told == 0.004
    assert math.isnan(play([0.004] * 8, [0.004, *[0.012] * 7]).astray)
    stuck.measure(13 * MS, 0.0045)
    assert math.isnan(stuck.astray)
    # a driver whose lag is of 25 samples, and a sensor that tells nothing
    assert math.isnan(play([0.0, *[0.012] * 40], [0.012 * (1.0 - 0.96**k) for k in range(41)]).astray)
    assert math.isnan(play([0.004] * 20, [math.nan] * 20).astray)
