"""The live page's memory of the loop and its buttons; tests/test_live.py has the page as a browser sees it."""

import http.client
import json
from pathlib import Path

import pytest
from lifecycle_msgs.srv import ChangeState
from vo2_interface.live import server
from vo2_interface.live.frames import Frames, TurningPoints
from vo2_interface.live.node import LiveNode
from vo2_interface.testing import bench

MS = 1_000_000


@pytest.mark.parametrize(
    ("path", "turns"),
    [
        ([0, 5, 10, 6, 2, 4, 8, 5], [10, 2, 8]),
        ([0, 5, 10, 6, 2, 4, 8, 5, 9, 7], [10, 2, 9]),  # a larger turn wipes out those within
        ([0, 10, 2, 8, 4, 6, 1, 3], [10, 1]),
        ([0, 10, 2, 8, 4, 11], []),  # beyond all of them
        ([0, 10, 9.5, 10, 9.6, float("nan"), 10], []),  # noise
    ],
)
def test_turning_points_are_kept_until_a_larger_turn_wipes_them_out(path, turns):
    memory = TurningPoints(1.0)
    for value in path:
        memory.follow(value, (value,))
    assert [value for value, _ in memory.points] == turns


def test_the_page_is_sent_the_places_of_the_turns_in_the_loop():
    frames = Frames(least_turn=5e-6)
    for k, tip in enumerate((0.0, 30e-6, 10e-6, 20e-6)):
        frames.measured(k * MS, 1e-3 * k, 1e5 - k, tip)
    assert json.loads(frames.since(0)[1])["memory"] == [[1e-3, 99999.0, 30e-6], [2e-3, 99998.0, 10e-6]]
    page = Path(server.__file__).with_name("page.html").read_text()
    assert "memory = frame.memory" in page and all(f'id="{name}"' in page for name in server.BUTTONS)


def press(port, name):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("POST", f"/{name}", headers={"X-VO2-Live": "1"})
    return connection.getresponse().status


def test_buttons_lead_the_managed_commander_through_its_life_cycle():
    asked = []

    def change(request, response):
        asked.append(request.transition.label)
        response.success = True
        return response

    with bench(["--ros-args", "-p", "port:=0", "-p", "commander:=feedforward"]) as rig:
        live = rig.add(LiveNode)
        assert press(live.port, "activate") == 503, "nobody is there"
        rig.node.create_service(ChangeState, "/vo2/feedforward/change_state", change)
        rig.until(lambda: live._commander.service_is_ready())
        for name in ("activate", "deactivate"):
            assert press(live.port, name) == 200
            rig.until(lambda name=name: bool(asked) and asked[-1] == name)
        assert press(live.port, "cleanup") == 404
