"""`fit` and `diagnose` over a folder: in parallel, on after an interruption, one table, one page.

The short form has a dozen bags; 1000 with `./vo2 test --all`.
"""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
import yaml
from concealed_devices import calibrated, concealed
from vo2_identification.bags import write_bag
from vo2_identification.batch.page import batch_page
from vo2_identification.batch.run import RESULT
from vo2_identification.diagnose import main as diagnose
from vo2_identification.fit import main as fit
from vo2_models.device import truth
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.model_file import save_model_parameters

CURRENT = np.repeat(damped_oscillation(np.linspace(3.68e-3, 8.49e-3, 12)), 8)
FIT = ["--device", "integrated", "--plays", "6", "--simulation-only"]


def write_wafer(folder: Path, count: int, *, devices: int = 5) -> Path:
    """So many bags, each with its place on a wafer in its metadata."""
    plain = [truth("integrated", seed=k).simulate(CURRENT, seed=k) for k in range(min(devices, count))]
    for k in range(count):
        bag = write_bag(folder / f"bag_{k:04d}", plain[k % devices])
        note = {
            "device_id": f"D{k}",
            "position_x_m": str(1e-3 * (k % 4)),
            "position_y_m": str(1e-3 * (k // 4)),
        }
        metadata = bag / "metadata.yaml"
        document = yaml.safe_load(metadata.read_text())
        document["rosbag2_bagfile_information"]["custom_data"] = note
        metadata.write_text(yaml.safe_dump(document, sort_keys=False))
    return folder


def start(bags: Path, output: Path, *more: str) -> subprocess.Popen:
    arguments = ["--bags", str(bags), "--output", str(output), *FIT, *more]
    return subprocess.Popen(
        [sys.executable, "-m", "vo2_identification.fit", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finished(output: Path) -> dict[str, int]:
    """Bag -> when its result was written."""
    return {each.parent.name: each.stat().st_mtime_ns for each in output.glob(f"bags/*/{RESULT}")}


def wait_for(process: subprocess.Popen, output: Path, count: int) -> None:
    until = time.monotonic() + 120.0
    while len(finished(output)) < count:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.02)


def workers_of(process: subprocess.Popen) -> list[int]:
    """Processes of the session that still live, beside the first."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            fields = (place / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == process.pid and int(place.name) != process.pid and fields[0] != "Z":
            found.append(int(place.name))
    return found


def test_an_interrupted_batch_goes_on_where_it_was(tmp_path):
    bags, output = write_wafer(tmp_path / "bags", 7), tmp_path / "out"
    (bags / "bag_0003" / "bag_0003_0.mcap").write_bytes(b"no bag")
    first = start(bags, output, "--jobs", "2")
    wait_for(first, output, 2)
    os.killpg(first.pid, signal.SIGINT)  # as a terminal does: the workers hear it too
    said, told = first.communicate(timeout=30)
    assert first.returncode == 130 and "interrupted" in told and "Traceback" not in told
    deadline = time.monotonic() + 10.0
    while workers_of(first) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert workers_of(first) == []
    before = finished(output)
    assert 2 <= len(before) < 7
    assert len(list(csv.DictReader((output / "table.csv").open()))) == len(before)

    second = start(bags, output, "--jobs", "2")
    said, told = second.communicate(timeout=120)
    assert second.returncode == 0, told
    assert f"6 bags done, 1 refused, 0 broken down; {len(before)} of them were finished before" in said
    assert re.search(r"bags, [\d.]+ per s, about .* left", told)
    after = finished(output)
    assert len(after) == 7 and all(after[name] == when for name, when in before.items())

    rows = list(csv.DictReader((output / "table.csv").open()))
    table = pyarrow.parquet.read_table(output / "table.parquet").to_pydict()
    assert [row["bag"] for row in rows] == table["bag"] == sorted(after)
    done = [row for row in rows if row["status"] == "done"]
    assert len(done) == 6 and "bag_0003" in next(row["reason"] for row in rows if row["status"] == "refused")
    for name in ("thermal.time_constant", "resistance.loop_width", "position_x_m"):
        assert [row[name] for row in rows] == ["" if value is None else str(value) for value in table[name]]
    assert all(1.5e-3 < float(row["thermal.time_constant"]) < 2.2e-3 for row in done)
    assert all(4.0 < float(row["resistance.loop_width"]) < 9.0 for row in done)
    page = (output / "report.html").read_text()
    assert (
        "Map of the wafer" in page and "thermal.time_constant over the wafer" in page and "bag_0003" in page
    )
    model = output / "bags" / "bag_0000" / "model.yaml"
    assert model.read_text().startswith("# fitted by `fit`")


def test_what_a_folder_cannot_be(tmp_path, capsys):
    bags = write_wafer(tmp_path / "bags", 1)
    output = ["--output", str(tmp_path / "out")]

    def refused(*arguments: str) -> str:
        assert fit([*arguments, *FIT]) == 2
        return capsys.readouterr().err.strip().splitlines()[-1]

    assert "no such folder" in refused("--bags", str(tmp_path / "nowhere"), *output)
    assert "is itself a bag" in refused("--bags", str(bags / "bag_0000"), *output)
    (tmp_path / "empty").mkdir()
    assert "found no bag" in refused("--bags", str(tmp_path / "empty"), *output)
    # dask is optional: what is wrong then is that it is not there
    wrong = "cannot be reached" if find_spec("distributed") else "found no dask.distributed here"
    assert wrong in refused("--bags", str(bags), *output, "--dask", "tcp://127.0.0.1:9")
    own = tmp_path / "out" / "bags" / "bag_0000"
    own.mkdir(parents=True)
    (own / "thesis.txt").write_text("mine")
    assert "is not a result of this command" in refused("--bags", str(bags), *output)
    assert (own / "thesis.txt").read_text() == "mine"
    for arguments in (["--bag", "a", "--bags", "b"], []):
        with pytest.raises(SystemExit) as error:
            fit([*arguments, *output, *FIT])
        assert error.value.code == 2


@pytest.mark.slow
def test_a_folder_is_diagnosed_against_one_model(tmp_path, capsys):
    save_model_parameters(tmp_path / "model.yaml", calibrated())
    write_bag(tmp_path / "bags" / "monday", concealed(samples=3000))
    write_bag(
        tmp_path / "bags" / "week_2" / "tuesday", concealed({"dead_time": {"delay": 2e-3}}, samples=3000)
    )
    (tmp_path / "bags" / "notes.txt").write_text("no bag")
    given = [
        "--bags",
        str(tmp_path / "bags"),
        "--model",
        str(tmp_path / "model.yaml"),
        "--quiet",
        "--jobs",
        "1",
    ]
    assert diagnose([*given, "--output", str(tmp_path / "out")]) == 0
    assert "2 bags done" in capsys.readouterr().out
    rows = list(csv.DictReader((tmp_path / "out" / "table.csv").open()))
    assert [(row["bag"], row["verdict"], row["effects"]) for row in rows] == [
        ("monday", "agrees", ""),
        ("week_2/tuesday", "differs", "dead_time"),
    ]
    assert float(rows[1]["dead_time.delay"]) == pytest.approx(2e-3, rel=0.2)
    folder = tmp_path / "out" / "bags" / "week_2" / "tuesday"
    assert json.loads((folder / "diagnosis.json").read_text())["verdict"] == "differs"
    assert (folder / "report.html").exists() and (folder / "corrected_model.yaml").exists()
    assert "History" in (tmp_path / "out" / "report.html").read_text()
    # another model is another question
    changed = calibrated() | {"model.thermal.ambient": 22.4}
    save_model_parameters(tmp_path / "model.yaml", changed)
    assert diagnose([*given, "--output", str(tmp_path / "out")]) == 0
    assert "0 of them were finished before" in capsys.readouterr().out


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_nothing(tmp_path):
    bags, output = write_wafer(tmp_path / "bags", 12), tmp_path / "out"
    process = start(bags, output, "--jobs", "2")
    wait_for(process, output, 2)
    os.kill(max(workers_of(process)), signal.SIGKILL)
    said, told = process.communicate(timeout=300)
    assert process.returncode == 0 and "12 bags done, 0 refused, 0 broken down" in said, told


@pytest.mark.slow
def test_a_batch_runs_on_a_dask_cluster(tmp_path):
    distributed = pytest.importorskip(
        "distributed", reason="optional: pip install 'vo2_identification[dask]'"
    )
    bags, output = write_wafer(tmp_path / "bags", 12), tmp_path / "out"
    local = tmp_path / "local"
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        assert (
            fit(["--bags", str(bags), "--output", str(output), *FIT, "--dask", cluster.scheduler_address])
            == 0
        )
    assert fit(["--bags", str(bags), "--output", str(local), *FIT, "--jobs", "1"]) == 0
    assert (output / "table.csv").read_bytes() == (local / "table.csv").read_bytes()


@pytest.mark.slow
def test_1000_bags_and_what_a_second_worker_brings(tmp_path, capsys):
    few, seconds = write_wafer(tmp_path / "few", 60), {}
    for jobs in (1, 2):
        began = time.monotonic()
        assert (
            fit(["--bags", str(few), "--output", str(tmp_path / f"few{jobs}"), *FIT, "--jobs", str(jobs)])
            == 0
        )
        seconds[jobs] = time.monotonic() - began
    bags, output = write_wafer(tmp_path / "bags", 1000, devices=50), tmp_path / "out"
    first = start(bags, output, "--jobs", "2")
    wait_for(first, output, 20)
    os.kill(first.pid, signal.SIGKILL)
    first.communicate()
    time.sleep(2.0)
    before, began = finished(output), time.monotonic()
    assert fit(["--bags", str(bags), "--output", str(output), *FIT, "--jobs", "2"]) == 0
    spent = time.monotonic() - began
    after = finished(output)
    assert len(after) == 1000 and all(after[name] == when for name, when in before.items())
    assert pyarrow.parquet.read_metadata(output / "table.parquet").num_rows == 1000
    with capsys.disabled():
        print(
            f"\nbatch: 60 bags in {seconds[1]:.1f} s with 1 worker, {seconds[2]:.1f} s with 2 "
            f"({seconds[1] / seconds[2]:.2f} times as fast); 1000 bags, killed after {len(before)}, of which none was "
            f"repeated, the rest in {spent:.0f} s with 2"
        )


def test_the_page_tells_which_bags_differ_and_that_most_share_something() -> None:
    verdicts = ["agrees", "differs", "differs", "differs"]
    rows = [
        {"bag": f"/bags/run_{k}", "device_id": "W1", "status": "done", "verdict": verdict, "start_s": 0.0,
         "position_x_m": None, "position_y_m": None,
         "effects": "creep" if verdict == "differs" else ""}
        for k, verdict in enumerate(verdicts)
    ]  # fmt: skip
    page = batch_page("diagnose", rows, {}, 0)
    assert page.index("run_1") < page.index("run_3") < page.index("run_0")
    assert "3 of 4 bags differ" in page
    assert "bags differ" not in batch_page("diagnose", rows[:2], {}, 0)
