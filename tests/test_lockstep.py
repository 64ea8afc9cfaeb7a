"""Three and more processes in lockstep: the same seed gives the same bag, whoever starts late."""

import hashlib
import signal
import time
from contextlib import closing

import pytest
from own_domain import processes
from vo2_identification.bags import raw_messages, read_bag
from vo2_studies.demo.conductor import Conductor
from vo2_studies.demo.graph import GraphError

END_S = 1.5
COUNT = round((END_S - 1.0) * 1000) + 1
"""Samples from the first stamp, 1 s, to END_S."""
SAMPLES = ("/vo2/command", "/vo2/measurement", "/vo2/estimate", "/vo2/reference")


def run_loop(graph, conductor, model_file, bag, *, late_estimator=False):
    """Run a loop up to END_S of simulated time; a late estimator starts when the others already stand waiting."""
    parameters = {
        "plant": {"seed": 5, "run_until_s": END_S},
        "controller": {"enabled": late_estimator},
        "reference": {"signal": "multisine"},
        "estimator": {"kind": "composite"},
    }
    conductor.forget()
    recorder = graph.start("record", arguments=["--output", str(bag), "--topics", *SAMPLES])
    for name in ("plant", "controller", "reference"):
        graph.start(name, parameters=parameters[name], parameter_file=model_file)
    met = {("/vo2/plant", "/vo2/measurement"): 2, ("/vo2/controller", "/vo2/command"): 2}
    met["/vo2/reference", "/vo2/reference"] = 2
    if late_estimator:
        conductor.wait_for_listeners(met)
        conductor.wait_for_recorder(recorder, [topic for topic in SAMPLES if topic != "/vo2/estimate"])
        conductor.pause(1.0)
    graph.start("estimator", parameters=parameters["estimator"], parameter_file=model_file)
    if not late_estimator:
        met |= {("/vo2/plant", "/vo2/measurement"): 3, ("/vo2/estimator", "/vo2/estimate"): 2}
        conductor.wait_for_listeners(met)
        conductor.wait_for_recorder(recorder, SAMPLES)
        conductor.set("/vo2/controller", {"enabled": True})
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


def test_a_recorder_that_hears_nobody_is_told_with_its_topics(graph, conductor, tmp_path):
    recorder = graph.start("record", arguments=["--output", str(tmp_path / "bag"), "--topics", *SAMPLES])
    graph.start("reference")
    conductor.wait_for_recorder(recorder, ["/vo2/reference"])
    with pytest.raises(GraphError, match=r"hears nobody on /vo2/command, /vo2/measurement$"):
        conductor.wait_for_recorder(
            recorder, ["/vo2/reference", "/vo2/measurement", "/vo2/command"], timeout_s=2.0
        )


@pytest.fixture(scope="module")
def bag(model_file, tmp_path_factory):
    """What a run leaves in which every node starts in time."""
    folder = tmp_path_factory.mktemp("in_time")
    with processes(folder / "logs") as graph, closing(Conductor(graph)) as conductor:
        run_loop(graph, conductor, model_file, folder / "bag")
    return folder / "bag"


def test_the_same_seed_gives_the_same_bag_bit_for_bit(bag, graph, conductor, model_file, tmp_path):
    run_loop(graph, conductor, model_file, tmp_path / "again")
    one, two = contents(bag), contents(tmp_path / "again")
    assert set(one) == set(SAMPLES)
    for topic in SAMPLES:
        assert len(one[topic]) == COUNT, topic
        assert one[topic] == two[topic], topic
    recordings, problems = read_bag(bag)
    assert problems == []
    assert recordings["measurement"].time_s[0] == 1.0


def test_an_estimator_that_starts_late_changes_nothing(bag, graph, conductor, model_file, tmp_path):
    run_loop(graph, conductor, model_file, tmp_path / "late", late_estimator=True)
    in_time, late = contents(bag), contents(tmp_path / "late")
    for topic in ("/vo2/measurement", "/vo2/command"):
        assert len(in_time[topic]) == COUNT, topic
        assert in_time[topic] == late[topic], topic
    # the recorder may meet the late node after its first samples, or after all of them; the commands answer them
    assert set(late.get("/vo2/estimate", [])) <= set(in_time["/vo2/estimate"])


def test_a_bag_is_readable_after_sigterm_in_the_middle_of_a_run(graph, conductor, model_file, tmp_path):
    bag = tmp_path / "bag"
    # diagnostics fill a bag too: of the samples alone the size tells their number
    recorder = graph.start("record", arguments=["--output", str(bag), "--topics", *SAMPLES])
    for name in ("plant", "estimator", "controller", "reference"):
        graph.start(name, parameter_file=model_file)
    # a second's worth: the loop starts before the recorder has found every topic
    conductor.wait_for("some samples in the bag", lambda: _size(bag) > 1_000_000, 60.0)
    recorder.process.send_signal(signal.SIGTERM)
    status, words = recorder.process.wait(15.0), recorder.last_words()
    # what was sent before a topic was found is lost, and told
    assert status == 0 or (status == 1 and " later than /vo2/" in words), words
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
