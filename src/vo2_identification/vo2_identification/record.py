"""`record`: put the topics of a running loop into a rosbag2 bag."""

from __future__ import annotations

import argparse
import gc
import re
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vo2_interface.executable import StopFlag

    from vo2_identification.bags import BagWriter
    from vo2_identification.recorder_node import Recorder

from vo2_models.command_line import Progress, refuse, until_loaded

__all__ = ["HEARS", "main"]

HEARS = "Hears"
"""Begins a line of the output that tells topics whose publisher the recorder has met: what was sent earlier may be missing."""

_DESCRIPTION = """
Record topics into a rosbag2 bag until Ctrl-C, SIGTERM, --duration or --messages. The bag is complete on disk
twice a second: if the process is killed or the disk is full, any tool still reads it up to there. Log times are
the stamps of the samples, so a run in simulated time gives the same bag every time. A line "Hears TOPIC" tells
from when on a topic's publisher is heard. What is missing is told while recording and at the end; a bag that
lacks messages ends with status 1.
"""
_ARRIVE_S = 0.3  # a few times what a publisher takes to notice that something is to be sent again
_POLL_S = 0.005
_DRAIN_S = 15.0  # at most, of the queue that a slow disk or busy processors left
_GATHER_S = 0.02
_LATE_S = 0.2  # not run for so long, and what arrived meanwhile may not have fitted into the socket's buffer
_SENT_AGAIN_S = 3.5  # within which publishers offer that once more: Fast DDS does every 3 s
_GIVEN_UP_S = 16.0  # publishers give up who is silent for 20 s (the lease of Fast DDS); it speaks every 3 s


def main(args: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status.

    0, 1 if the disk failed or messages are missing, 2 on bad input, 130 after Ctrl-C while it loads.

    Parameters
    ----------
    args : command line, None for that of the process
    """
    options, ros_args = _parser().parse_known_args(args)
    return until_loaded("record", "nothing is recorded", lambda: _run(options, ros_args))


def _run(options: argparse.Namespace, ros_args: list[str]) -> int:
    if "--ros-args" not in ros_args and ros_args:
        return refuse("record", f"{ros_args[0]}: no such option; see --help")
    for name in ("duration", "messages", "max_bag_size", "max_bag_duration"):
        value = getattr(options, name)
        if value is not None and value <= 0:
            return refuse("record", f"--{name.replace('_', '-')}: found {value:g}, need a number above 0")
    if sum(map(bool, (options.topics, options.all, options.regex))) > 1:
        return refuse("record", "found several of --topics, --all, --regex; need one of them")
    try:
        re.compile(options.regex or "")
    except re.error as error:
        return refuse("record", f"--regex: found {options.regex!r}, need a regular expression ({error})")
    # rclpy and rosbags take a second to load: --help and bad options do not wait for them
    from vo2_identification.bags import BagError, BagWriter

    try:
        bag = BagWriter(
            options.output,
            storage=options.storage,
            compression=options.compression,
            split_bytes=options.max_bag_size,
            split_s=options.max_bag_duration,
        )
    except BagError as error:
        return refuse("record", error)
    status = 2
    try:
        status = _record(bag, options, ros_args)
    finally:
        bag.close()
        if status and not bag.count:
            bag.discard()
    return status


def _record(bag: BagWriter, options: argparse.Namespace, ros_args: list[str]) -> int:
    from rclpy.exceptions import InvalidNamespaceException
    from rclpy.validate_namespace import validate_namespace
    from vo2_interface.executable import StopFlag, join_graph, leave_graph

    from vo2_identification.recorder_node import Recorder, contract_topics

    if options.namespace:
        try:
            validate_namespace(f"/{options.namespace.strip('/')}")
        except InvalidNamespaceException as error:
            return refuse("record", f"--namespace: {error}")
    topics = wanted = None
    if options.topics:
        known = contract_topics(options.namespace or "/vo2")
        topics = {name: known.get(name, "") for name in options.topics}
    elif options.all or options.regex:
        topics, wanted = {}, re.compile(options.regex or "")
    elif options.namespace:
        topics = contract_topics(options.namespace)
    stop = StopFlag()
    recorder = None
    try:
        join_graph([sys.argv[0], *ros_args])
        recorder = Recorder(bag, topics, wanted)
        recorder.idle()
        what = ", ".join(recorder.topics) if wanted is None else "what appears on the graph"
        print(f"Recording {what} into {bag.path}; Ctrl-C ends it.", flush=True)
        gc.freeze()  # what is loaded by now never goes: without it every collection stalls the loop
        with Progress("record", lines=False) as progress:
            stood_still_s = _take_all(recorder, options, stop, progress)
        recorder.finish()
        failure = recorder.failure
        try:
            bag.close()
        except OSError as error:
            failure = failure or error
        return _summary(recorder, options, failure, stood_still_s)
    except (ValueError, RuntimeError) as error:  # rclpy raises bare RuntimeErrors of its C layer
        return refuse("record", error)
    finally:
        leave_graph(None, [] if recorder is None else [recorder])


class _Stalls:
    """How long this process stood still, looked at wherever it may have.

    Attributes
    ----------
    now : monotonic time of the last look [s]
    longest_s : longest time between two looks [s]
    late_until : monotonic time until which what a stall kept out may be sent again [s]
    """

    def __init__(self) -> None:
        self.now = self.late_until = time.monotonic()
        self.longest_s = 0.0

    def look(self) -> float:
        """Return the monotonic time [s]."""
        before, self.now = self.now, time.monotonic()
        self.longest_s = max(self.longest_s, self.now - before)
        if self.now - before > _LATE_S:
            self.late_until = self.now + _SENT_AGAIN_S
        return self.now


def _take_all(recorder: Recorder, options: argparse.Namespace, stop: StopFlag, progress: Progress) -> float:
    """Record until it is time to stop; return the longest time for which this process did not run."""
    period = recorder.bag.flush_period_s
    stalls = _Stalls()
    started = shown = stalls.now
    count_shown = lost_told = skipped_told = 0
    met: set[str] = set()
    while not stop.is_set and recorder.failure is None:
        # waking up for every message would take time from the loop beside it: they wait for each other
        time.sleep(_GATHER_S)
        recorder.take(most=options.messages)
        now = stalls.look()
        if _enough(recorder, options):
            return stalls.longest_s
        if options.duration is not None and now - started >= options.duration:
            break
        if now - shown >= period:
            recorder.idle()
            if new := recorder.met - met:
                met |= new
                progress.clear()
                print(f"{HEARS} {', '.join(sorted(new))}", flush=True)
            rate = (recorder.count - count_shown) / (now - shown)
            progress(None, f"{recorder.count} messages in {now - started:.0f} s, {rate:.0f} per second now")
            shown, count_shown = now, recorder.count
            if recorder.lost >= 2 * lost_told and recorder.lost:
                lost_told = recorder.lost
                progress.clear()
                print(f"record: {lost_told} messages did not arrive so far", file=sys.stderr, flush=True)
            if recorder.without_sample >= 2 * skipped_told and recorder.without_sample:
                skipped_told = recorder.without_sample
                progress.clear()
                print(
                    f"record: {skipped_told} sample periods without a sample so far",
                    file=sys.stderr,
                    flush=True,
                )
    # what was published before the stop belongs into the bag, however long the queue has become
    stopped_ns, stopped = time.time_ns(), stalls.look()
    heard = stopped
    while (now := stalls.look()) < min(max(heard + _ARRIVE_S, stalls.late_until), stopped + _DRAIN_S):
        if recorder.take(before_ns=stopped_ns, most=options.messages):
            heard = now
        else:
            time.sleep(_POLL_S)
    return stalls.longest_s


def _enough(recorder: Recorder, options: argparse.Namespace) -> bool:
    return options.messages is not None and recorder.count >= options.messages


def _summary(
    recorder: Recorder, options: argparse.Namespace, failure: OSError | None, stood_still_s: float
) -> int:
    bag, lost_limit = recorder.bag, options.lost_limit
    counts = ", ".join(f"{topic} {count}" for topic, count in sorted(bag.counts.items())) or "none"
    if failure is not None and not bag.count:
        print(
            f"record: {bag.path}: cannot be written ({failure.strerror or failure}); nothing was recorded; "
            "free some space and record again",
            file=sys.stderr,
        )
        return 1
    if failure is not None:
        print(
            f"record: {bag.path}: cannot be written any more ({failure.strerror or failure}); the bag is closed and "
            f"readable with {bag.count} messages; free some space and record again",
            file=sys.stderr,
        )
        return 1
    if not bag.count:
        print(
            f"record: no message came on {', '.join(recorder.topics) or 'any topic'}; is the loop running, "
            "with this ROS_DOMAIN_ID?",
            file=sys.stderr,
        )
    repeats = f"; {recorder.repeats} exact repeats left out" if recorder.repeats else ""
    print(f"Recorded {bag.count} messages ({counts}{repeats}). The bag: {bag.path}", flush=True)
    for line in recorder.missing():
        print(f"record: {line}", file=sys.stderr)
    if recorder.lost > lost_limit:
        print(
            f"record: the bag lacks {recorder.lost} messages, more than --lost-limit {lost_limit}: this machine was too "
            "busy or a publisher's queue too short; record again",
            file=sys.stderr,
        )
        return 1
    if 100.0 * recorder.most_missing > options.gap_limit:
        print(
            f"record: {100.0 * recorder.most_missing:.3g} % of a topic's sample periods have no sample, more than --gap-limit "
            f"{options.gap_limit:g}: its source did not keep its pace; a lower rate_hz, or less beside it, may help",
            file=sys.stderr,
        )
        return 1
    if stood_still_s > _GIVEN_UP_S:
        print(
            f"record: stood still for {stood_still_s:.0f} s: publishers give up a listener after {_GIVEN_UP_S:.0f} to 20 s, "
            "and what they sent then may be missing; record again",
            file=sys.stderr,
        )
        return 1
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="record", description=_DESCRIPTION, allow_abbrev=False)
    parser.add_argument(
        "--output",
        default=f"vo2_bag_{datetime.now():%Y_%m_%d-%H_%M_%S}",
        help="Folder of the new bag; it must not exist. Default: vo2_bag_ with date and time, here.",
    )
    parser.add_argument(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        help="Topics to record, with their full names. Default: the command, measurement, estimate and reference "
        "of the namespace, /diagnostics and /clock.",
    )
    parser.add_argument(
        "-a", "--all", action="store_true", help="Record every topic that appears on the graph."
    )
    parser.add_argument(
        "-e", "--regex", metavar="PATTERN", help="Record every topic whose name the pattern is found in."
    )
    parser.add_argument(
        "--namespace", help="Namespace of the loop. Default: that of --ros-args -r __ns:=, else /vo2."
    )
    parser.add_argument(
        "--storage", choices=["mcap", "sqlite3"], default="mcap", help="Storage of the bag. Default: mcap."
    )
    parser.add_argument(
        "--compression",
        choices=["none", "zstd", "lz4"],
        default="none",
        help="Compression of the chunks of an mcap file, which every reader of MCAP undoes. Default: none.",
    )
    parser.add_argument(
        "-b", "--max-bag-size", type=int, metavar="BYTES", help="Begin another mcap file at this size."
    )
    parser.add_argument(
        "-d",
        "--max-bag-duration",
        type=float,
        metavar="S",
        help="Begin another mcap file after so many seconds of the samples' clock.",
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="Stop after so many seconds of wall time."
    )
    parser.add_argument(
        "--lost-limit",
        type=int,
        default=0,
        metavar="N",
        help="Messages that may fail to arrive before the exit status is 1. Default: 0.",
    )
    parser.add_argument(
        "--gap-limit",
        type=float,
        default=5.0,
        metavar="PERCENT",
        help="Sample periods of a topic that may be without a sample before the exit status is 1. Default: 5.",
    )
    parser.add_argument("--messages", type=int, metavar="N", help="Stop after so many messages in all.")
    return parser


if __name__ == "__main__":
    sys.exit(main())
