"""Many devices in one process: each in a namespace of its own, with a seed of its own, and no wrong row."""

import pytest
from vo2_interface.testing import bench
from vo2_interface.timers import sharing_timers
from vo2_models.device import truth
from vo2_plant_sim.plants import device, main

CHANNELS = ("heater_current", "film_resistance", "tip_deflection")
S = 1_000_000_000


def test_each_device_has_its_namespace_its_seed_and_what_a_file_says_of_it(tmp_path):
    file = tmp_path / "devices.yaml"
    file.write_text("/device_4/plant: {ros__parameters: {seed: 11}}\n")
    with bench(["--ros-args", "--params-file", str(file)]) as rig:
        for number in (3, 4):
            rig.hear(f"/device_{number}/measurement", CHANNELS)
        with sharing_timers():
            for number in (3, 4):
                rig.add(lambda number=number: device(number))
        rig.until(lambda: all(rig.heard.values()))
        heard = {name: samples[0] for name, samples in rig.heard.items()}
        assert rig.node.count_publishers("/clock") == 0
    for name, seed in (("/device_3/measurement", 3), ("/device_4/measurement", 11)):
        assert heard[name] == (S, tuple(truth("integrated", seed=seed).stepper(seed=seed + 1).step(0.0)))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--count", "0"], "found --count 0 --first 0, need at least 1 device"),
        (["--count", "1", "--first", "-1"], "found --count 1 --first -1, need at least 1 device"),
        (["--count", "2", "--ros-args", "-r", "__ns:=/lab"], "found the namespace /lab for all devices"),
    ],
)
def test_a_row_that_cannot_be_is_one_line(given, said, capsys):
    assert main(["plants", *given]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
