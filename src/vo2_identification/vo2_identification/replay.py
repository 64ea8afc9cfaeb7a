"""`replay`: publish the messages of a rosbag2 bag on the graph."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from vo2_identification.bags.channels import Channel
    from vo2_identification.bags.playback import Outline
    from vo2_identification.replay_control import ReplayControl

from vo2_models.command_line import Progress, refuse, until_loaded

__all__ = ["main"]

_DESCRIPTION = """
Publish the messages of a rosbag2 bag with the quality of service they were recorded with, in the rhythm of their log
times, as they are: stamps are not changed. Only a second and later pass of --loop moves the stamps on by the length
of the bag, so that they go on increasing. In a terminal, space pauses and resumes, the right arrow or s plays one
message; so do the services ~/pause (std_srvs/srv/SetBool) and ~/step (std_srvs/srv/Trigger) of the node `replay`.
"""
_SLICE_S = 0.05
_SETTLE_S = 0.3
_ACKNOWLEDGE_S = 30.0  # a subscriber with a long queue takes the rest only as it works that off
_SLIP_S = 0.02
_QUEUE = 5000
_NS = 1_000_000_000


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 0, 2 on bad input, 130 after Ctrl-C while it loads.

    Parameters
    ----------
    args : command line, None for that of the process
    """
    options, ros_args = _parser().parse_known_args(args)
    return until_loaded("replay", "nothing is played", lambda: _run(options, ros_args))


def _run(options: argparse.Namespace, ros_args: list[str]) -> int:
    if "--ros-args" not in ros_args and ros_args:
        return refuse("replay", f"{ros_args[0]}: no such option; see --help")
    for name, low in (("rate", 0.0), ("clock", 0.0), ("duration", 0.0), ("loop", 0.0)):
        value = getattr(options, name)
        if value is not None and not low < value < math.inf and not (name == "loop" and value == -1):
            return refuse("replay", f"--{name}: found {value:g}, need a number above 0")
    for name in ("offset", "wait"):
        if not getattr(options, name) >= 0:
            return refuse(
                "replay", f"--{name}: found {getattr(options, name):g}, need a number of at least 0"
            )
    from vo2_identification.bags.playback import outline
    from vo2_identification.bags.problems import BagError

    try:
        bag = outline(options.bag, options.topics)
        length = (bag.last_ns - bag.first_ns) / _NS
        if options.offset > length:
            raise BagError(f"--offset: found {options.offset:g} s, but the bag is {length:.6g} s long")
    except BagError as error:
        return refuse("replay", error)
    for problem in bag.problems[:10]:
        print(f"replay: {problem}", file=sys.stderr)
    if options.clock and bag.channels.pop("/clock", None):
        print("replay: the bag's own /clock is left out, since --clock makes one", file=sys.stderr)
    return _replay(bag, options, ros_args)


def _replay(bag: Outline, options: argparse.Namespace, ros_args: list[str]) -> int:
    import rclpy
    from vo2_interface.executable import StopFlag, join_graph, leave_graph

    stop = StopFlag()
    node = None
    try:
        join_graph(ros_args)
        node = rclpy.create_node("replay")
        return _publish_all(node, bag, options, lambda: stop.is_set)
    except (ValueError, RuntimeError) as error:  # rclpy raises bare RuntimeErrors of its C layer
        return refuse("replay", error)
    finally:
        leave_graph(None, [] if node is None else [node])


def _publish_all(node: Node, bag: Outline, options: argparse.Namespace, stopped: Callable[[], bool]) -> int:
    from vo2_identification.bags.channels import message_class
    from vo2_identification.bags.playback import schedule
    from vo2_identification.replay_control import KEYS, ReplayControl

    publishers: dict[str, Publisher] = {}
    latched = []
    for topic, channel in list(bag.channels.items()):
        try:
            kind = message_class(channel.msgtype)
        except ValueError:
            print(f"replay: {topic} is left out: {channel.msgtype} is not installed here", file=sys.stderr)
            del bag.channels[topic]
            continue
        qos, is_latched = _qos(channel)
        publishers[topic] = node.create_publisher(kind, topic, qos)
        if is_latched:
            latched.append(topic)
    if not publishers:
        return refuse("replay", f"{options.bag}: no topic left to play")
    tell_time = _clock_publisher(node, options.clock) if options.clock else None
    silent = _wait_for_subscribers(publishers, options.wait, stopped)
    if silent:
        print(f"replay: nobody listens to {', '.join(silent)}; playing all the same", file=sys.stderr)
    passes = None if options.loop == -1 else int(options.loop or 1)
    if passes != 1:
        step = bag.pass_ns / _NS
        print(
            f"Looping: each pass moves the stamps on by {step:.6g} s, so that they go on increasing.",
            flush=True,
        )
    due_messages = schedule(
        options.bag,
        bag,
        offset_s=options.offset,
        duration_s=options.duration,
        passes=passes,
        latched=latched,
    )
    count, slipped, last = 0, 0.0, bag.first_ns
    progress = Progress("replay", lines=False)
    with ReplayControl(node, paused=options.start_paused) as control:
        if control.keys:
            print(f"Keys: {KEYS}.", flush=True)
        began = shown = time.monotonic()
        stood = 0.0
        for due in due_messages:
            control.look()
            if control.paused:
                stood += _stand(control, began + slipped + stood + due.due_s / options.rate, stopped)
            target = began + slipped + stood + due.due_s / options.rate
            if (behind := time.monotonic() - target) > _SLIP_S:
                slipped += (
                    behind  # catching up in a burst would overrun the queues: rather lose time than samples
                )
            while not stopped() and (remaining := target - time.monotonic()) > 0:
                if tell_time:
                    tell_time(due.time_ns - round(remaining * options.rate * _NS))
                time.sleep(min(remaining, _SLICE_S, 1 / options.clock if tell_time else _SLICE_S))
                control.look()
                if control.paused:
                    moved = _stand(control, target, stopped)
                    stood, target = stood + moved, target + moved
            if stopped():
                break
            if tell_time:
                tell_time(due.time_ns)
            publishers[due.topic].publish(due.data)
            count, last = count + 1, due.time_ns
            if (now := time.monotonic()) - shown > 1.0:
                progress(None, f"{count} messages, {(last - bag.first_ns) / _NS:.1f} s into the bag")
                shown = now
    took = time.monotonic() - began
    if not stopped():
        _wait_for_readers(publishers, stopped)  # the last messages are still on their way
    progress.clear()
    slow = (
        f" ({slipped:.2f} s longer than planned: this machine could not keep up)" if slipped > _SLIP_S else ""
    )
    ended = "Stopped after" if stopped() else "Replayed"
    print(
        f"{ended} {count} messages of {', '.join(sorted(publishers))} in {took:.2f} s at rate {options.rate:g}{slow}, "
        f"up to {last / _NS:.9g} s. The bag: {options.bag}",
        flush=True,
    )
    return 0


def _stand(control: ReplayControl, target_s: float, stopped: Callable[[], bool]) -> float:
    """Stand until the replay goes on or one message is to be played; return by how much its time moves [s].

    Parameters
    ----------
    control : of the replay
    target_s : when the next message would be due [s]
    stopped : whether the end was asked for

    Returns
    -------
    float
    """
    began = time.monotonic()
    while control.paused and not stopped():
        if control.take_step():
            return time.monotonic() - target_s
        time.sleep(_SLICE_S / 5)
        control.look()
    return time.monotonic() - began


def _wait_for_subscribers(
    publishers: dict[str, Publisher], wait_s: float, stopped: Callable[[], bool]
) -> list[str]:
    """Wait until every topic has a subscriber and none has come for a while, at most `wait_s`; return the topics without one.

    Who is on the graph already is met one after the other: what is published before would be lost to the others.
    """
    began = since = time.monotonic()
    known: dict[str, int] = {}
    while True:
        found = {topic: publisher.get_subscription_count() for topic, publisher in publishers.items()}
        now = time.monotonic()
        if found != known:
            known, since = found, now
        silent = [topic for topic, count in found.items() if not count]
        if stopped() or now - began >= wait_s or (not silent and now - since >= _SETTLE_S):
            break
        time.sleep(0.02)
    told = ", ".join(f"{topic} to {count}" for topic, count in known.items() if count)
    if told:
        print(f"Playing {told} subscribers; who comes later misses what was before.", flush=True)
    return silent


def _wait_for_readers(publishers: dict[str, Publisher], stopped: Callable[[], bool]) -> None:
    """Wait until every reliable subscriber has acknowledged what was published; say so where one does not."""
    from rclpy.duration import Duration

    deadline = time.monotonic() + _ACKNOWLEDGE_S
    for topic, publisher in publishers.items():
        while not publisher.wait_for_all_acked(Duration(seconds=_SLICE_S)):
            if stopped() or time.monotonic() > deadline:
                print(
                    f"replay: a subscriber of {topic} has not taken the last messages yet and may lack them",
                    file=sys.stderr,
                )
                break


def _clock_publisher(node: Node, rate_hz: float) -> Callable[[int], None]:
    """Return a function that publishes the bag's time, at most `rate_hz` times a second and never backwards."""
    from rosgraph_msgs.msg import Clock
    from vo2_interface.samples import ClockWriter
    from vo2_interface.topics import SAMPLE_QOS

    publisher = node.create_publisher(Clock, "/clock", SAMPLE_QOS)
    writer = ClockWriter()
    state = {"next": 0.0, "told": -1}

    def tell(time_ns: int) -> None:
        now = time.monotonic()
        if now >= state["next"] and time_ns > state["told"]:
            publisher.publish(writer.write(time_ns))
            state["next"], state["told"] = now + 1 / rate_hz, time_ns

    return tell


def _qos(channel: Channel) -> tuple[Any, bool]:
    """Return the QoS that the topic was offered with, and whether it is transient local."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
    from rosbags.interfaces import QosDurability, QosHistory, QosReliability
    from rosbags.rosbag2.metadata import parse_qos

    from vo2_identification.bags.qos import contract_qos

    offered = parse_qos(channel.qos) or [contract_qos(channel.topic)]
    latched = all(one.durability is QosDurability.TRANSIENT_LOCAL for one in offered)
    reliable = all(one.reliability is not QosReliability.BEST_EFFORT for one in offered)
    keep_all = any(one.history is QosHistory.KEEP_ALL for one in offered)
    # a recorder of discovered publishers knows no depth and stores 0: then the contract's
    depth = max(one.depth for one in offered) or contract_qos(channel.topic).depth
    if reliable and not latched:
        depth = max(depth, _QUEUE)  # nobody sees it, and a subscriber that stalls loses nothing
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )
    return profile, latched


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="replay", description=_DESCRIPTION, allow_abbrev=False)
    parser.add_argument("bag", help="The bag: its folder, or a single .mcap or .db3 file.")
    parser.add_argument("--rate", type=float, default=1.0, help="Speed: 2 plays twice as fast. Default: 1.")
    parser.add_argument(
        "--loop",
        type=int,
        nargs="?",
        const=-1,
        metavar="N",
        help="Play the bag again and again until Ctrl-C, or N times.",
    )
    parser.add_argument(
        "--offset", type=float, default=0.0, metavar="S", help="Leave out the first S seconds."
    )
    parser.add_argument("--duration", type=float, metavar="S", help="Play only S seconds of the bag.")
    parser.add_argument("--topics", nargs="+", metavar="TOPIC", help="Play only these topics. Default: all.")
    parser.add_argument(
        "--clock",
        type=float,
        nargs="?",
        const=100.0,
        metavar="HZ",
        help="Publish the bag's time on /clock, HZ times a second (100 if no number is given).",
    )
    parser.add_argument("--start-paused", action="store_true", help="Begin paused.")
    parser.add_argument(
        "--wait",
        type=float,
        default=3.0,
        metavar="S",
        help="Wait at most S seconds until every topic has a subscriber and no more come, then start. Default: 3.",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
