"""The hardware node against a simulated instrument, over a real TCP socket and a real pseudo terminal."""

import math
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rig_template.link import LinkError, open_link
from rig_template.rig_node import RigNode
from std_srvs.srv import SetBool
from vo2_interface.model import operating_point
from vo2_interface.testing import bench

POINT = operating_point("integrated")
CHANNELS = ("heater_current", "film_resistance", "tip_deflection")


class Wire:
    """A running instrument, and every line that it was sent."""

    def __init__(self, *arguments):
        command = [sys.executable, "-m", "rig_template.instrument", "--log", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.lines = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._address = ""

    @property
    def address(self):
        self._address = self._address or self.process.stdout.readline().strip()
        return self._address

    def _read(self):
        for line in self.process.stderr:
            self.lines.append(line.strip())

    def currents(self):
        return [float(line.split()[1]) for line in self.lines if line.startswith("SOUR:CURR ")]

    def end(self):
        self.process.kill()
        self.process.wait()
        self._reader.join()
        self.process.stdout.close()
        self.process.stderr.close()


@pytest.fixture(scope="module")
def wires():
    """All kinds of instrument: they start together, since each loads the simulation."""
    kinds = {
        "tcp": ("--port", "0"),
        "pty": ("--pty",),
        "silent": ("--port", "0", "--silent-after", "1.0"),
        "garbled": ("--port", "0", "--garbled-after", "1.0"),
        "beyond": ("--port", "0", "--beyond-after", "1.0"),
    }
    found = {name: Wire(*arguments) for name, arguments in kinds.items()}
    yield found
    for wire in found.values():
        wire.end()


@contextmanager
def rig_at(address, *parameters):
    arguments = ["--ros-args", "-p", f"connection:={address}", "-p", "rate_hz:=20.0", "-p", "timeout_s:=1.0"]
    for parameter in parameters:
        arguments += ["-p", parameter]
    with bench(arguments) as rig:
        rig.hear("/vo2/measurement", CHANNELS)
        nodes = []
        try:
            yield rig, lambda: nodes.append(rig.add(RigNode)) or nodes[-1]
        finally:
            for node in nodes:
                node.close()


def command(rig, current, seconds=0.5):
    """Answer the measurements of some time with a current, as a commander does."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        stamp = rig.heard["/vo2/measurement"][-1][0]
        rig.say("/vo2/command", stamp, {"heater_current": current})
        rig.spin(0.02)


def change(rig, label):
    client = rig.node.create_client(ChangeState, "/vo2/rig/change_state")
    rig.until(client.service_is_ready)
    answer = client.call_async(ChangeState.Request(transition=Transition(label=label)))
    rig.until(answer.done)
    return answer.result().success


@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_it_measures_drives_and_ends_at_the_safe_current_with_the_output_off(wires, kind):
    wire = wires[kind]
    with rig_at(wire.address) as (rig, add):
        node = add()
        rig.until(lambda: len(rig.heard["/vo2/measurement"]) > 5)
        cold = rig.heard["/vo2/measurement"][-1][1]
        assert cold[1] > 1e5, "a cold film"
        command(rig, 0.008, 1.0)
        hot = rig.heard["/vo2/measurement"][-1][1]
        assert hot[0] == pytest.approx(0.008, rel=0.05)
        assert hot[1] < 0.5 * cold[1]
        assert hot[2] > cold[2] + 10e-6
        rig.until(lambda: "skipped" in rig.status("rig: pace")[1])
        node.close()
        rig.spin(0.2)
    assert wire.lines[-2:] == ["SOUR:CURR 0", "OUTP OFF"]


def test_limits_of_the_device_file_hold_on_the_wire_and_silence_leads_to_the_safe_current(wires):
    wire = wires["tcp"]
    with rig_at(wire.address) as (rig, add):
        add()
        rig.until(lambda: len(rig.heard["/vo2/measurement"]) > 2)
        before = len(wire.currents())
        command(rig, 1.0)
        told = [text for name, text, _ in rig.statuses if name.endswith("rig: command")]
        assert sum("outside the 0 to 0.01278 A" in text for text in told) == 1, told
        rig.until(lambda: "no command for 3 periods" in rig.status("rig: command")[0])
        rig.until(lambda: wire.currents()[-1] == 0.0)
        assert max(wire.currents()[before:]) == pytest.approx(POINT.most_a)
        command(rig, float("nan"))
        assert wire.currents()[-1] == 0.0


def test_an_emergency_stop_reaches_the_wire_and_the_output_is_off_unless_active(wires):
    wire = wires["tcp"]
    with rig_at(wire.address, "autostart:=false") as (rig, add):
        node = add()
        rig.spin(0.2)
        assert not rig.heard["/vo2/measurement"]
        assert change(rig, "configure")
        rig.until(lambda: wire.lines[-2:] == ["SOUR:CURR 0", "OUTP OFF"])
        assert change(rig, "activate")
        rig.until(lambda: rig.heard["/vo2/measurement"])
        command(rig, 0.006)
        assert wire.currents()[-1] == 0.006
        stop = rig.node.create_client(SetBool, "/vo2/rig/emergency_stop")
        rig.until(stop.service_is_ready)
        stop.call_async(SetBool.Request(data=True))
        rig.until(lambda: node._stop.active)
        command(rig, 0.006, 0.3)
        assert wire.currents()[-1] == 0.0
        assert change(rig, "deactivate")
        assert change(rig, "cleanup")
        rig.until(lambda: wire.lines[-1] == "OUTP OFF")


@pytest.mark.parametrize(("kind", "words"), [("silent", "no answer within"), ("garbled", "need 3 numbers")])
def test_an_instrument_that_fails_is_left_safe_and_may_be_taken_again(wires, kind, words):
    wire = wires[kind]
    with rig_at(wire.address) as (rig, add):
        node = add()
        rig.until(lambda: rig.heard["/vo2/measurement"])
        command(rig, 0.006, 0.3)
        rig.until(lambda: words in rig.status("rig: instrument")[0])
        rig.until(lambda: node.lifecycle_state == "unconfigured")
        rig.until(lambda: wire.lines[-2:] == ["SOUR:CURR 0", "OUTP OFF"])
        rig.until(lambda: "configure and activate it again" in rig.status("rig: lifecycle")[0])
        # of a new connection: it fails a second later only
        assert change(rig, "configure")
        assert change(rig, "activate")
        count = len(rig.heard["/vo2/measurement"])
        rig.until(lambda: len(rig.heard["/vo2/measurement"]) > count)


def test_a_reading_beyond_the_range_is_told_and_no_value(wires):
    with rig_at(wires["beyond"].address) as (rig, add):
        add()
        rig.until(lambda: "no value of tip_deflection" in rig.status("rig: reading")[0])
        rig.until(lambda: math.isnan(rig.heard["/vo2/measurement"][-1][1][2]))
        assert all(map(math.isfinite, rig.heard["/vo2/measurement"][-1][1][:2]))


def test_a_connection_that_breaks_is_told(wires):
    wire = Wire("--port", "0")
    try:
        with rig_at(wire.address) as (rig, add):
            node = add()
            rig.until(lambda: rig.heard["/vo2/measurement"])
            wire.process.send_signal(signal.SIGKILL)
            rig.until(lambda: "tcp://127.0.0.1" in rig.status("rig: instrument")[0])
            rig.until(lambda: "switch it off, do so by hand" in rig.status("rig: instrument")[0])
            assert node.lifecycle_state == "unconfigured"
            assert not change(rig, "configure")
            rig.until(lambda: "is the instrument on?" in rig.status("rig: lifecycle")[0])
    finally:
        wire.end()


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://127.0.0.1:1", "Connection refused"),
        ("serial:///dev/no_such_port", "No such file"),
        ("serial:///dev/null?baud=115201", "baud: found 115201"),
        ("udp://127.0.0.1:5", "need tcp://HOST:PORT"),
    ],
)
def test_an_address_without_instrument_is_one_line(address, words):
    with pytest.raises(LinkError, match=words) as refused:
        open_link(address, 0.2)
    assert "\n" not in str(refused.value)


def test_no_instrument_ends_the_command_with_a_status_after_which_it_may_be_started_again():
    arguments = ["--ros-args", "-p", "connection:=tcp://127.0.0.1:1"]
    process = subprocess.run(
        [sys.executable, "-m", "rig_template.rig_node", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
    )
    # 2 is for what cannot be used, which `supervise` does not start again
    assert process.returncode == 1
    assert process.stderr.splitlines()[-1].startswith(
        "rig_node.py: connection: tcp://127.0.0.1:1: Connection"
    )
