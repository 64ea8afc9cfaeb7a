"""Environment of ROS processes that stay on this host and must not lose a sample."""

from __future__ import annotations

from pathlib import Path

__all__ = ["FASTDDS_PROFILE", "one_host_environment"]

FASTDDS_PROFILE = Path(__file__).with_name("fastdds.xml")
"""Fast DDS settings with long shared-memory queues: with the usual ones (512 messages for a whole process), a
listener that waits a quarter of a second for a processor loses samples for good, in spite of reliable delivery."""


def one_host_environment(domain: int) -> dict[str, str]:
    """Return the variables to add to the environment of every process on the ROS domain `domain`."""
    return {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(FASTDDS_PROFILE),
        # numerical libraries would start as many threads as cores in each of a dozen processes
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
