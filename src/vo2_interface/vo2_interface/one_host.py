"""Settings of ROS processes that stay on this host and must not lose a sample; they come with every process.

Whoever starts a node (`ros2 run`, `ros2 launch`, `python -m`), the process itself takes them before it joins the
graph, so that nothing depends on the shell it was started from. What the user has set stays as it is:

- `ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET` opens the graph to the network. Without it every socket is bound to the
  loopback interface, so that another host can neither join nor command.
- `FASTRTPS_DEFAULT_PROFILES_FILE` puts a profile of one's own in the place of both of ours.
"""

from __future__ import annotations

import fcntl
import itertools
import os
import re
import tempfile
import time
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import IO

from vo2_models.io import InputError, read_yaml

__all__ = [
    "FASTDDS_LOOPBACK_PROFILE",
    "FASTDDS_NETWORK_PROFILE",
    "free_domain",
    "keeps_wall_time",
    "missing_settings",
    "one_host_environment",
    "reclaim_shared_memory",
]

FASTDDS_LOOPBACK_PROFILE = Path(__file__).with_name("fastdds_loopback.xml")
"""Fast DDS settings with long shared-memory queues: with the usual ones (512 messages for a whole process), a
listener that waits a quarter of a second for a processor loses samples for good, in spite of reliable delivery."""
FASTDDS_NETWORK_PROFILE = Path(__file__).with_name("fastdds_network.xml")
"""The same on all interfaces."""
_WALL_PROFILES = {
    str(profile): str(profile.with_stem(f"{profile.stem}_wall"))
    for profile in (FASTDDS_LOOPBACK_PROFILE, FASTDDS_NETWORK_PROFILE)
}
"""The same without shared memory: with it, 2 of 33 killed readers made their publisher wait, one for 2.3 s (for a lock in
the dead reader's memory, as far as is known); over sockets none of 62 did."""

_SHARED_MEMORY = Path("/dev/shm")
_YOUNG_S = 5.0
"""Age below which a file may belong to a process that is just making it [s]."""
_DOMAINS = itertools.count(os.getpid())
_LAST: deque[IO[str]] = deque(maxlen=10)
"""Locks of the last domains of this process: eight test runs beside each other leave some of the hundred free."""
_KEPT: list[IO[str]] = []
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"


def free_domain(*, keep: bool = False) -> int:
    """Return a ROS domain that no other run has, of this process or another: a lock tells the others.

    Parameters
    ----------
    keep : whether it is this process's own until it ends; otherwise until ten others were asked for

    Raises
    ------
    RuntimeError : all hundred are taken.
    """
    if not keep and len(_LAST) == _LAST.maxlen:
        _LAST.popleft().close()
    # three rounds: while one goes on, other runs let domains go behind it and take those before it
    for number in itertools.islice(_DOMAINS, 300):
        domain = 1 + number * 37 % 100
        lock = (Path(tempfile.gettempdir()) / f"vo2_domain_{domain}.{os.getuid()}").open("w")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            continue
        (_KEPT if keep else _LAST).append(lock)
        return domain
    raise RuntimeError("found no free ROS domain of 1 to 100, need one that no other run holds")


def missing_settings(
    environment: Mapping[str, str] = os.environ, *, wall_time: bool = False
) -> dict[str, str]:
    """Return the variables to set beside those of `environment`, in which nothing of the user's is changed.

    Parameters
    ----------
    environment : of the process
    wall_time : whether the process must keep the pace of wall time, whoever is killed beside it
    """
    given = environment.get(_PROFILE, "")
    if given and given not in _WALL_PROFILES:
        wanted = {_RANGE: "LOCALHOST"}
    else:
        network = environment.get(_RANGE, "").upper() == "SUBNET"
        profile = given or str(FASTDDS_NETWORK_PROFILE if network else FASTDDS_LOOPBACK_PROFILE)
        # LOCALHOST would add Fast DDS's own transports, which open sockets on every interface: the profile says it all
        wanted = {_RANGE: "SYSTEM_DEFAULT", _PROFILE: _WALL_PROFILES[profile] if wall_time else profile}
    return {
        name: value
        for name, value in wanted.items()
        if not environment.get(name) or (name == _PROFILE and environment[name] != value)
    }


def keeps_wall_time(line: Sequence[str]) -> bool:
    """Return whether ROS arguments set a parameter `time` to `wall`; asked before there is a node that could tell.

    Parameters
    ----------
    line : command line of the process
    """
    for option, value in pairwise(line):
        if option in ("-p", "--param") and re.search(r"(?:^|:)time:=\W*wall\W*$", value):
            return True
        if option == "--params-file":
            try:
                if _sets_wall(read_yaml(value)):
                    return True
            except InputError:  # whoever reads the parameters tells it
                continue
    return False


def _sets_wall(tree: object) -> bool:
    if not isinstance(tree, dict):
        return False
    return any(value == "wall" if key == "time" else _sets_wall(value) for key, value in tree.items())


def one_host_environment(domain: int) -> dict[str, str]:
    """Return the variables of processes on the ROS domain `domain` that stay on this host, whatever the user has set."""
    return {
        "ROS_DOMAIN_ID": str(domain),
        **missing_settings({}),
        # numerical libraries would start as many threads as cores in each of a dozen processes
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }


def reclaim_shared_memory(folder: Path = _SHARED_MEMORY) -> int:
    """Remove the Fast DDS segments (16 MB each) of processes of this user that were killed; return how many.

    A process holds a lock on the file `fastrtps_*_el` beside its segment for as long as it lives. Those of ports need
    no care, as Fast DDS itself takes over one whose owner is gone, but for one without content: its maker was killed before it
    had given it a size, and whoever opens that port waits for the size without end.

    Parameters
    ----------
    folder : where the system keeps shared memory
    """
    count = 0
    for port in folder.glob("fastrtps_port*[0-9]"):
        try:
            about = port.stat()
            old = time.time() - about.st_mtime >= _YOUNG_S
            if old and about.st_size == 0 and about.st_uid == os.geteuid():
                port.unlink()
                count += 1
        except FileNotFoundError:  # another process has just removed it
            continue
    for lock in folder.glob("fastrtps_*_el"):
        segment = lock.with_name(lock.name.removesuffix("_el"))
        try:
            about = lock.stat()
            young = time.time() - about.st_mtime < _YOUNG_S
            if young or about.st_uid != os.geteuid() or segment.name.startswith("fastrtps_port"):
                continue
            descriptor = os.open(lock, os.O_RDONLY)
        except OSError:  # another process has just removed it
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            segment.unlink(missing_ok=True)
            lock.unlink(missing_ok=True)
            count += 1
        except BlockingIOError:  # its process lives
            continue
        finally:
            os.close(descriptor)
    return count
