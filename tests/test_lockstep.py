"""Three and more processes in lockstep: the same seed gives the same bag, whoever starts late."""

import hashlib
import signal
import time

import pytest
from vo2_identification.bags import raw_messages, read_bag

END_S = 1.5
SAMPLES = ("/vo2/command", "/vo2/measurement", "/vo2/estimate", "/vo2/reference")


def run_loop(graph, conductor, model_file, bag, *, late=()):
    """Run a loop up to END_S of simulated time; the nodes in `late` start after the others stand waiting."""
    parameters = {
        "plant": {"seed": 5, "run_until_s": END_S},
        "estimator": {"kind": "composite"},
        "controller": {},
        "reference": {"signal": "multisine"},
    }
    recorder = graph.start("record", arguments=["--output", str(bag), "--topics", *SAMPLES, "/clock"])
    conductor.wait_for_links(dict.fromkeys(SAMPLES, (0, 1)))
    for name in sorted(parameters, key=lambda name: name in late):
        if name in late:
            conductor.pause(1.0)
        graph.start(name, parameters=parameters[name], parameter_file=model_file)
    conductor.wait_for(
        "the end of the run", lambda: conductor.value("vo2/plant: time", "stamp_s") != "", 60.0
    )
    conductor.pause(0.5)
    graph.end(recorder)
    graph.end()


def contents(bag):
    """Topic -> (stamp, hash of the bytes) of every message, in order."""
    found: dict[str, list[tuple[int, str]]] = {}
    problems: list = []
    for message in raw_messages(bag, problems):
        digest = hashlib.sha256(message.data).hexdigest()
        found.setdefault(message.channel.topic, []).append((message.log_time_ns, digest))
    assert problems == []
    return found


def test_the_same_seed_gives_the_same_bag_bit_for_bit_and_late_nodes_change_nothing(
    graph, conductor, model_file, tmp_path
):
    run_loop(graph, conductor, model_file, tmp_path / "one")
    conductor.statuses.clear()
    run_loop(graph, conductor, model_file, tmp_path / "two", late=("estimator", "reference"))
    one, two = contents(tmp_path / "one"), contents(tmp_path / "two")
    assert set(one) >= set(SAMPLES)
    for topic in SAMPLES:
        assert len(one[topic]) == round((END_S - 1.0) * 1000) + 1, topic
        assert one[topic] == two[topic], topic
    recordings, problems = read_bag(tmp_path / "one")
    assert problems == []
    assert recordings["measurement"].time_s[0] == 1.0


def test_a_bag_is_readable_after_sigterm_in_the_middle_of_a_run(graph, conductor, model_file, tmp_path):
    bag = tmp_path / "bag"
    recorder = graph.start("record", arguments=["--output", str(bag)])
    for name in ("plant", "estimator", "controller", "reference"):
        graph.start(name, parameter_file=model_file)
    conductor.wait_for("some samples in the bag", lambda: _size(bag) > 50_000, 60.0)
    recorder.process.send_signal(signal.SIGTERM)
    assert recorder.process.wait(15.0) == 0, recorder.last_words()
    recordings, problems = read_bag(bag)
    assert len(recordings["measurement"]) > 100
    assert not [problem for problem in problems if problem.kind in ("truncated", "damaged")]


def _size(bag):
    return sum(path.stat().st_size for path in bag.glob("*.mcap"))


@pytest.mark.slow
def test_wall_time_keeps_its_rate(graph, conductor, model_file, tmp_path):
    bag = tmp_path / "bag"
    shared = {"time": "wall", "rate_hz": 100.0}
    recorder = graph.start("record", arguments=["--output", str(bag), "--topics", *SAMPLES])
    graph.start("plant", parameters=shared)
    graph.start("controller", parameters=shared, parameter_file=model_file)
    for name in ("estimator", "reference"):
        graph.start(name, parameter_file=model_file)
    conductor.wait_for_nodes([f"/vo2/{name}" for name in ("plant", "estimator", "controller", "reference")])
    conductor.pause(1.0)
    started = time.monotonic()
    conductor.pause(10.0)
    graph.end(recorder)
    seconds = time.monotonic() - started
    recordings, _ = read_bag(bag)
    count = len(recordings["measurement"])
    assert count >= 0.95 * 100.0 * seconds
    assert len(recordings["command"]) >= 0.95 * 100.0 * seconds
