"""Settings of ROS processes that stay on this host and must not lose a sample; they come with every process.

Whoever starts a node (`ros2 run`, `ros2 launch`, `python -m`), the process itself takes them before it joins the
graph, so that nothing depends on the shell it was started from. What the user has set stays as it is:

- `ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET` opens the graph to the network. Without it every socket is bound to the
  loopback interface, so that another host can neither join nor command.
- `FASTRTPS_DEFAULT_PROFILES_FILE` puts a profile of one's own in the place of both of ours.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Mapping
from pathlib import Path

__all__ = [
    "FASTDDS_LOOPBACK_PROFILE",
    "FASTDDS_NETWORK_PROFILE",
    "missing_settings",
    "one_host_environment",
    "reclaim_shared_memory",
]

FASTDDS_LOOPBACK_PROFILE = Path(__file__).with_name("fastdds_loopback.xml")
"""Fast DDS settings with long shared-memory queues: with the usual ones (512 messages for a whole process), a
listener that waits a quarter of a second for a processor loses samples for good, in spite of reliable delivery."""
FASTDDS_NETWORK_PROFILE = Path(__file__).with_name("fastdds_network.xml")
"""The same on all interfaces."""

_SHARED_MEMORY = Path("/dev/shm")
_YOUNG_S = 5.0
"""Age below which a file may belong to a process that is just making it [s]."""
_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"


def missing_settings(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the variables to set beside those of `environment`, none of which is changed."""
    if environment.get(_PROFILE):
        wanted = {_RANGE: "LOCALHOST"}
    elif environment.get(_RANGE, "").upper() == "SUBNET":
        wanted = {_PROFILE: str(FASTDDS_NETWORK_PROFILE)}
    else:
        # LOCALHOST would add Fast DDS's own transports, which open sockets on every interface: the profile says it all
        wanted = {_RANGE: "SYSTEM_DEFAULT", _PROFILE: str(FASTDDS_LOOPBACK_PROFILE)}
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


def reclaim_shared_memory(folder: Path = _SHARED_MEMORY) -> int:
    """Remove the Fast DDS segments (16 MB each) of processes of this user that were killed; return how many.

    A process holds a lock on the file `fastrtps_*_el` beside its segment for as long as it lives. Those of ports need
    no care: Fast DDS itself takes over one whose owner is gone.

    Parameters
    ----------
    folder : where the system keeps shared memory
    """
    count = 0
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
