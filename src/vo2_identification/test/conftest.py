"""What all tests of this package need."""

import threading

import pytest
from tqdm import TMonitor
from vo2_interface.testing import hear_ctrl_c

hear_ctrl_c()
IDLE = ("IO loop", "Dask-Offload")
"""Threads that dask.distributed keeps for the next cluster; they rest meanwhile."""


@pytest.fixture(autouse=True)
def no_thread_works_on():
    """Wait for the threads that a test leaves behind, and fail the test where one works on for more than 5 s.

    Where a later test stops `tracemalloc` while the thread allocates, Python 3.11 can die of SIGSEGV (python/cpython#128679).
    """
    before = set(threading.enumerate())
    yield
    left = [
        each
        for each in threading.enumerate()
        if each not in before and not isinstance(each, TMonitor) and not each.name.startswith(IDLE)
    ]
    for thread in left:
        thread.join(timeout=5.0)
    assert not [thread.name for thread in left if thread.is_alive()]
