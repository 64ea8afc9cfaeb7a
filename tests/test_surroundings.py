"""What a laboratory's host does to a program: another locale, a place that cannot be written, a second graph."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_plain_start import installed, running, wait_for
from vo2_interface.testing import bench, free_domain

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
            wait_for(lambda: "fastrtps_port" in Path(f"/proc/{far.pid}/maps").read_text(), "the second graph")
            rig.spin(1.0)
            assert rig.heard["/two/measurement"] == []
            with running([*plant, "__ns:=/two"], dict(os.environ)):
                rig.until(lambda: len(rig.heard["/two/measurement"]) > 3, 60.0)


@pytest.mark.slow
def test_fifty_devices_on_one_host(capfd):
    with bench() as rig:
        names = [f"/device_{k}/measurement" for k in range(50)]
        for name in names:
            rig.hear(name, ("heater_current", "film_resistance"))
        plants = []
        try:
            for k in range(50):
                line = ["--ros-args", "-p", "clock:=false", "-p", f"seed:={k}", "-r", f"__ns:=/device_{k}"]
                plants.append(
                    subprocess.Popen([installed("vo2_plant_sim", "plant"), *line], stderr=subprocess.DEVNULL)
                )
            rig.until(lambda: all(rig.heard[name] for name in names), 540.0)
            for name in names:
                stamp, (_, resistance) = rig.heard[name][-1]
                assert stamp == 1_000_000_000 and 1e3 < resistance < 1e6
            assert all(plant.poll() is None for plant in plants)
            memory = [int(Path(f"/proc/{p.pid}/statm").read_text().split()[1]) * 4096 / 1e6 for p in plants]
        finally:
            for plant in plants:
                plant.kill()
                plant.wait()
    with capfd.disabled():
        print(f"\n50 devices on this host: all heard, {max(memory):.0f} MB each at most")
