"""The live page: what a browser on this host sees of samples at 1 kHz, what it costs, and that only this host is served."""

import http.client
import json
import math
import os
import shutil
import subprocess
import sys
import time
import urllib.request
from base64 import b64decode

import numpy as np
import pytest
from std_msgs.msg import Bool
from vo2_interface.live.frames import Frames
from vo2_interface.live.node import LiveNode
from vo2_interface.live.simulated import SimulatedBeside
from vo2_interface.testing import bench
from vo2_interface.topics import EMERGENCY_STOP, EMERGENCY_STOP_QOS
from vo2_models.device.model import DeviceModel

MS = 1_000_000
SECONDS = 8


@pytest.fixture
def live():
    with bench(["--ros-args", "-p", "port:=0"]) as rig:
        yield rig, rig.add(LiveNode)


def request(port, method, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request(method, path, headers=headers)
    return connection.getresponse()


def test_samples_are_joined_by_stamp_and_sent_once():
    frames = Frames()
    for k in range(4):
        frames.measured(k * MS, 5e-3, 1e5, 31e-6)
        frames.referred(k * MS, 30e-6 + k * 1e-6)
        frames.estimated(k * MS, 32e-6, 2e-6)
        frames.estimated((k - 1) * MS, 99.0, 99.0)  # too late: its sample is complete
    count, line = frames.since(1)
    rows = json.loads(line)["rows"]
    assert count == 3 and [row[0] for row in rows] == [0.001, 0.002]
    assert rows[0][1:7] == pytest.approx([5e-3, 1e5, 31e-6, 32e-6, 2e-6, 31e-6])
    assert json.loads(frames.since(count)[1])["rows"] == []


def test_what_is_no_number_is_sent_as_none():
    frames = Frames()
    frames.measured(0, math.nan, math.inf, 1e-6)
    frames.measured(MS, 0.0, 1.0, 1e-6)
    assert json.loads(frames.since(0)[1])["rows"] == [[0.0, None, None, 1e-6, *[None] * 6]]


def levels(count=100):
    """Cold at first, then levels of 20 ms over the operating range [A]."""
    random = np.random.default_rng(0).uniform(3.68e-3, 8.49e-3, count)
    return np.concatenate([np.zeros(50), np.repeat(random, 20)])


def beside(model_file, recording, every=1):
    """What the simulation beside a device says of every sample: (n, 3) resistance, deflection, whether it differs."""
    simulation = SimulatedBeside(DeviceModel.load(model_file))
    columns = (recording[name] for name in ("heater_current", "film_resistance", "tip_deflection"))
    samples = list(zip(*columns, strict=True))
    return np.array([simulation.step(k * MS, *samples[k]) for k in range(0, len(samples), every)])


def test_the_simulation_beside_a_device_marks_the_place_where_they_differ(model_file):
    device = DeviceModel.load(model_file).simulation
    recording = device.simulate(levels(), seed=5)
    same = beside(model_file, recording)
    assert np.all(np.isnan(same[:5])), "nobody knows the memory before the device has been cold"
    assert np.nanmax(same[:, 2]) == 0.0
    assert np.nanmean(np.abs(same[:, 1] - recording["tip_deflection"])) < 0.1e-6
    clipped: dict[str, dict[str, float | str]] = {
        "adc_saturation": {"signal": "tip_deflection", "high": 40e-6}
    }
    changed = beside(model_file, device.with_effects(clipped).simulate(levels(), seed=5))
    above = changed[:, 1] > 42e-6
    assert np.sum(above) > 500 and np.all(changed[above, 2] == 1.0)
    assert np.nanmax(changed[changed[:, 1] < 40e-6, 2]) == 0.0


def test_the_simulation_beside_a_device_holds_the_drive_while_samples_are_lost(model_file):
    recording = DeviceModel.load(model_file).simulate(levels(), seed=5)
    # of every fifth sample it hears; the levels change with one that it hears
    few, all_ = beside(model_file, recording, 5), beside(model_file, recording)[::5]
    np.testing.assert_array_equal(few[10:], all_[10:])


def test_a_model_that_is_no_model_of_the_loop_is_one_line(model_file):
    arguments = ["-m", "vo2_interface.live.node", "--ros-args", "-p", "preset:=peltier", "-p"]
    run = subprocess.run(
        [sys.executable, *arguments, f"model:={model_file}"], capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 2 and "need one of the preset peltier" in run.stderr
    assert len(run.stderr.splitlines()) == 1


def test_the_page_gets_what_the_simulation_expects(model_file):
    recording = DeviceModel.load(model_file).simulate(np.zeros(60), seed=5)
    with bench(["--ros-args", "-p", "port:=0", "-p", f"model:={model_file}"]) as rig:
        node = rig.add(LiveNode)
        assert isinstance(node, LiveNode)
        assert json.loads(request(node.port, "GET", "/device").read())["model"] is True
        for k in range(60):
            sample = {name: float(recording[name][k]) for name in recording.channels}
            rig.say("/vo2/measurement", k * MS, sample | ({"tip_deflection": 9e-6} if k == 58 else {}))
            rig.spin(0.01)
        stream = request(node.port, "GET", "/frames")
        (row,) = json.loads(stream.readline()[6:])["rows"]
    assert row[3] == 9e-6 and row[9] == 1.0
    assert row[8] == pytest.approx(recording["tip_deflection"][58], abs=1e-6)


def test_a_device_of_ones_own_is_shown_in_its_units_whatever_its_channels_are_called(tmp_path):
    (tmp_path / "stack.yaml").write_text(
        "schema: vo2-device/1\nid: stack\ndrive: {channel: volts, unit: V, limits: [0.0, 60.0]}\n"
        "responses:\n  force: {unit: N, range: [0.0, 90.0]}\n"
    )
    with bench(["--ros-args", "-p", "port:=0", "-p", f"preset:={tmp_path / 'stack.yaml'}"]) as rig:
        node = rig.add(LiveNode)
        assert isinstance(node, LiveNode)
        told = json.loads(request(node.port, "GET", "/device").read())
        assert told["drive"] == ["volts", "V"] and told["response"] == ["force", "N"]
        assert (
            told["drive_range"] == [0.0, 60.0] and told["resistance_ohm"] is None and told["length_m"] is None
        )
        for k, (drive, response) in enumerate(
            [("heater_current", "tip_deflection"), ("volts", "force"), ("volts", "force")]
        ):
            rig.say("/vo2/measurement", k * MS, {drive: 20.0 + k, response: 40.0 + k})
            rig.spin(0.05)
        rows = json.loads(node._frames.since(1)[1])["rows"] + json.loads(node._frames.since(0)[1])["rows"]
    assert [row[1:4] for row in rows] == [[21.0, None, 41.0], [21.0, None, 41.0]]


def test_the_graph_reaches_the_page(live):
    rig, node = live
    for k in range(5):
        rig.say(
            "/vo2/measurement",
            k * MS,
            {"heater_current": 5e-3, "film_resistance": 1e5, "tip_deflection": 3e-5},
        )
        rig.spin(0.02)
    stream = request(node.port, "GET", "/frames")
    (row,) = json.loads(stream.readline()[6:])["rows"]
    assert row[1:4] == [5e-3, 1e5, 3e-5]
    assert json.loads(request(node.port, "GET", "/device").read())["id"] == "integrated"


def test_stop_and_release_are_said_on_the_graph(live):
    rig, node = live
    heard = []
    rig.node.create_subscription(
        Bool, EMERGENCY_STOP, lambda word: heard.append(word.data), EMERGENCY_STOP_QOS
    )
    for path, word in (("/stop", True), ("/release", False)):
        assert request(node.port, "POST", path, **{"X-VO2-Live": "1"}).status == 200
        rig.until(lambda word=word: bool(heard) and heard[-1] is word)


@pytest.mark.parametrize(
    ("method", "path", "headers"),
    [
        ("POST", "/stop", {}),  # as a form on another page would
        ("GET", "/", {"Host": "elsewhere.example"}),  # a foreign name that was pointed at this host
        ("POST", "/stop", {"Host": "elsewhere.example", "X-VO2-Live": "1"}),
    ],
)
def test_pages_of_others_are_refused(live, method, path, headers):
    assert request(live[1].port, method, path, **headers).status == 403


def test_only_this_host_is_served(live):
    assert live[1]._server._server.server_address[0] == "127.0.0.1"


def test_a_port_that_is_taken_is_one_line(live):
    port = live[1].port
    run = subprocess.run(
        [sys.executable, "-m", "vo2_interface.live.node", "--ros-args", "-p", f"port:={port}"],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 2 and f"port: found {port}, which is not free" in run.stderr


class Browser:
    """Headless Chromium behind chromedriver's plain HTTP interface."""

    def __init__(self, port):
        self.base = f"http://127.0.0.1:{port}"
        options = {"args": ["--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1200,1000"]}
        wanted = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": options}}}
        self.base += f"/session/{self.call('POST', '/session', wanted)['sessionId']}"

    def call(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        asked = urllib.request.Request(
            self.base + path, data, {"Content-Type": "application/json"}, method=method
        )
        with urllib.request.urlopen(asked, timeout=60) as answer:
            return json.load(answer)["value"]

    def run(self, script):
        return self.call("POST", "/execute/sync", {"script": script, "args": []})


@pytest.fixture
def browser():
    driver = shutil.which("chromedriver")
    if driver is None or shutil.which("chromium") is None:
        pytest.skip("chromium and chromedriver are not installed: apt-get install chromium chromium-driver")
    process = subprocess.Popen([driver, "--port=0"], stdout=subprocess.PIPE, text=True)
    try:
        port = next(
            int(line.rsplit(" ", 1)[1].rstrip(".\n"))
            for line in process.stdout or ()
            if "successfully on port" in line
        )
        found = Browser(port)
        yield found
        found.call("DELETE", "")
    finally:
        process.terminate()
        process.wait()


def cpu_s(pid):
    with open(f"/proc/{pid}/stat") as file:
        fields = file.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.slow
def test_thirty_frames_a_second_at_1_khz_for_a_quarter_of_a_core(browser, tmp_path):
    """Processor time of the node is measured against the wall, so that a busy machine does not spoil it."""
    with bench() as rig:
        node = subprocess.Popen(
            [sys.executable, "-m", "vo2_interface.live.node", "--ros-args", "-p", "port:=0"],
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            address = next(
                line.split("open ")[1].split(" in")[0] for line in node.stderr or () if "open http" in line
            )
            rig.say("/vo2/reference", 0, {"tip_deflection": 30e-6})
            browser.call("POST", "/url", {"url": address})
            k, start, spent, seen = 0, time.monotonic(), 0.0, 0
            while (now := time.monotonic() - start) < SECONDS:
                while k * 1e-3 < now:
                    level = math.sin(2 * math.pi * 0.5 * k * 1e-3)
                    tip = 30e-6 + 20e-6 * level
                    values = {
                        "heater_current": 6e-3 + 2e-3 * level,
                        "film_resistance": 10 ** (4.7 - 0.6 * math.sin(2 * math.pi * 0.5 * k * 1e-3 - 0.4)),
                        "tip_deflection": tip + 1e-6 * math.sin(k),
                    }
                    rig.say("/vo2/measurement", k * MS, values)
                    rig.say("/vo2/estimate", k * MS, {"tip_deflection": tip, "tip_deflection_bound": 0.8e-6})
                    k += 1
                rig.executor.spin_once(timeout_sec=0.001)
                if not spent and now > 2.0:
                    spent, seen, since = (
                        cpu_s(node.pid),
                        browser.run("return window.frames_seen"),
                        time.monotonic(),
                    )
            wall = time.monotonic() - since
            share = (cpu_s(node.pid) - spent) / wall
            frames = (browser.run("return window.frames_seen") - seen) / wall
            (tmp_path / "page.png").write_bytes(b64decode(browser.call("GET", "/screenshot")))
            told = browser.run("return document.body.innerText")
            drawn = browser.run("return [window.frames_drawn, rows.length]")
            print(
                f"{frames:.1f} frames/s, {100 * share:.0f} % of a core, drawn {drawn}, {tmp_path / 'page.png'}"
            )
            assert "running" in told and "30.00 µm" in told and drawn[0] > 10 and drawn[1] > 1000
            assert frames > 27.0 and share < 0.25
        finally:
            node.terminate()
            assert node.wait(timeout=20) == 0
