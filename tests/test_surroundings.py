"""What a laboratory's host does to a program: another locale, a place that cannot be written, a second graph."""

import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from test_plain_start import bound_addresses, installed, running, wait_for
from vo2_interface.one_host import free_domain
from vo2_interface.testing import bench

GERMAN = """
import locale, sys
locale.setlocale(locale.LC_ALL, "de_DE.UTF-8")
assert locale.localeconv()["decimal_point"] == ","
from vo2_identification.{module} import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def german(tmp_path):
    """Environment with a locale whose decimal mark is a comma."""
    place = tmp_path / "locales"
    place.mkdir()
    made = subprocess.run(
        ["localedef", "-i", "de_DE", "-f", "UTF-8", str(place / "de_DE.UTF-8")], capture_output=True
    )
    if not (place / "de_DE.UTF-8").exists():
        pytest.skip(f"no German locale can be made here: {made.stderr.decode()[:100]}")
    return {**os.environ, "LOCPATH": str(place), "LC_ALL": "de_DE.UTF-8", "LANG": "de_DE.UTF-8"}


def test_a_decimal_comma_changes_no_number(german, tmp_path):
    (tmp_path / "table.csv").write_text("t,I\n" + "".join(f"{k}.5,{4 + 0.25 * k}\n" for k in range(20)))
    (tmp_path / "map.yaml").write_text(
        "description: rig\ndevice: integrated\nformat: csv\nheader_row: 1\ntime: {column: t, unit: s}\n"
        "channels: {heater_current: {column: I, unit: mA, scale: 1.5}}\n"
    )
    written = {}
    for name, environment in (("german", german), ("plain", dict(os.environ))):
        bag = tmp_path / name
        code = GERMAN.format(module="convert")
        if name == "plain":
            code = "".join(line + "\n" for line in code.splitlines() if "locale" not in line).replace(
                "from vo2", "import sys\nfrom vo2"
            )
        arguments = ["--map", "map.yaml", "--input", "table.csv", "--output", str(bag)]
        ended = subprocess.run(
            [sys.executable, "-c", code, *arguments],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 0, ended.stderr
        written[name] = (bag / f"{name}_0.mcap").read_bytes().replace(name.encode(), b"name")
    assert len(written["german"]) > 1000
    # the files differ by their names alone, which stand in no sample
    assert abs(len(written["german"]) - len(written["plain"])) < 64
    from vo2_identification.bags import read_recording

    found = {name: read_recording(tmp_path / name)[0] for name in written}
    np.testing.assert_array_equal(found["german"].time_s, found["plain"].time_s)
    np.testing.assert_array_equal(found["german"]["heater_current"], found["plain"]["heater_current"])
    assert found["german"]["heater_current"][1] == pytest.approx(1.5e-3 * 4.25)


def test_a_place_that_cannot_be_written_is_one_line_before_the_work():
    # not even root can write there
    arguments = ["--bag", "nowhere", "--device", "integrated", "--output", "/proc/vo2/model.yaml"]
    ended = subprocess.run(
        [installed("vo2_identification", "fit"), *arguments], capture_output=True, text=True
    )
    assert ended.returncode == 2
    assert "/proc" in ended.stderr and len(ended.stderr.splitlines()) == 1, ended.stderr


def test_two_graphs_in_other_namespaces_and_domains_do_not_meet():
    with bench() as rig:
        own = int(os.environ["ROS_DOMAIN_ID"])
        for space in ("one", "two"):
            rig.hear(f"/{space}/measurement", ("heater_current",))
        plant = [installed("vo2_plant_sim", "plant"), "--ros-args", "-p", "clock:=false", "-r"]
        foreign = dict(os.environ, ROS_DOMAIN_ID=str(free_domain()))
        assert foreign["ROS_DOMAIN_ID"] != str(own)
        with (
            running([*plant, "__ns:=/one"], dict(os.environ)),
            running([*plant, "__ns:=/two"], foreign) as far,
        ):
            rig.until(lambda: len(rig.heard["/one/measurement"]) > 3, 60.0)
            wait_for(lambda: bound_addresses(far.pid), "the second graph")
            rig.spin(1.0)
            assert rig.heard["/two/measurement"] == []
            with running([*plant, "__ns:=/two"], dict(os.environ)):
                rig.until(lambda: len(rig.heard["/two/measurement"]) > 3, 60.0)


@pytest.fixture
def fifty():
    """Start fifty devices as the documentation says, with parameters; the process and its topics."""
    with bench() as rig, ExitStack() as ends:

        def start(*parameters):
            names = [f"/device_{k}/measurement" for k in range(50)]
            for name in names:
                rig.hear(name, ("heater_current", "film_resistance"))
            given = [word for parameter in parameters for word in ("-p", parameter)]
            command = [installed("vo2_plant_sim", "plants"), "--count", "50", "--ros-args", *given]
            return rig, names, ends.enter_context(running(command, dict(os.environ)))

        yield start


@pytest.mark.slow
def test_fifty_devices_on_one_host(fifty, capfd):
    began = time.monotonic()
    rig, names, plants = fifty()
    patience = began + 300.0
    rig.until(lambda: all(rig.heard[name] for name in names) or time.monotonic() > patience, 540.0)
    took_s = time.monotonic() - began
    heard = [rig.heard[name][-1] for name in names if rig.heard[name]]
    memory = int(Path(f"/proc/{plants.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    began = time.monotonic()
    plants.send_signal(signal.SIGINT)
    told, _ = plants.communicate(timeout=60.0)
    with capfd.disabled():
        print(
            f"\n50 devices on this host: {len(heard)} heard within {took_s:.0f} s, {memory / 1e6:.0f} MB together, "
            f"ended within {time.monotonic() - began:.1f} s of Ctrl-C"
        )
    assert len(heard) == 50 and plants.returncode == 0
    assert all(stamp == 1_000_000_000 for stamp, _ in heard)
    resistances = {resistance for _, (_, resistance) in heard}
    assert len(resistances) == 50 and all(1e3 < each < 1e6 for each in resistances)
    assert "Warning" not in told


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize("rate_hz", [10, 50, 100])
def test_fifty_devices_keep_the_pace_of_wall_time(rate_hz, fifty, capfd):
    rig, names, _ = fifty("time:=wall", f"rate_hz:={rate_hz}.0")
    rig.until(lambda: all(rig.heard[name] for name in names), 300.0)
    rig.spin(2.0)  # until the last have met
    before = rig.counts()
    rig.spin(10.0)
    taken = [len(rig.heard[name]) - before[name] for name in names]
    skipped = []
    for name in names:
        stamps = np.array([stamp for stamp, _ in rig.heard[name][before[name] :]])
        skipped.append(np.sum(np.rint(np.diff(stamps) * 1e-9 * rate_hz) - 1) / (rate_hz * 10.0))
    with capfd.disabled():
        print(
            f"\n50 devices at {rate_hz} Hz in wall time: {min(taken) / 10:.1f} to {max(taken) / 10:.1f} samples/s heard of "
            f"each, {100 * np.mean(skipped):.2f} % of the periods skipped, {100 * max(skipped):.2f} % of the worst device"
        )
    # faster than that is told, not promised
    assert rate_hz > 10 or max(skipped) < 0.1
