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
import tempfile
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import IO

__all__ = [
    "FASTDDS_LOOPBACK_PROFILE",
    "FASTDDS_NETWORK_PROFILE",
    "free_domain",
    "missing_settings",
    "one_host_environment",
]

FASTDDS_LOOPBACK_PROFILE = Path(__file__).with_name("fastdds_loopback.xml")
"""Fast DDS settings with long queues and quick repair, over sockets alone: the files say why."""
FASTDDS_NETWORK_PROFILE = Path(__file__).with_name("fastdds_network.xml")
"""The same on all interfaces."""

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


def missing_settings(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the variables to set beside those of `environment`, in which nothing of the user's is changed.

    Parameters
    ----------
    environment : of the process
    """
    if environment.get(_PROFILE):
        wanted = {_RANGE: "LOCALHOST"}
    else:
        network = environment.get(_RANGE, "").upper() == "SUBNET"
        profile = str(FASTDDS_NETWORK_PROFILE if network else FASTDDS_LOOPBACK_PROFILE)
        # LOCALHOST would add Fast DDS's own transports, which open sockets on every interface: the profile says it all
        wanted = {_RANGE: "SYSTEM_DEFAULT", _PROFILE: profile}
    return {name: value for name, value in wanted.items() if not environment.get(name)}


def one_host_environment(domain: int) -> dict[str, str]:
    """Return the variables of processes on the ROS domain `domain` that stay on this host, whatever the user has set."""
    return {
        "ROS_DOMAIN_ID": str(domain),
        **missing_settings({}),
        # numerical libraries would start as many threads as cores in each of a dozen processes
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
