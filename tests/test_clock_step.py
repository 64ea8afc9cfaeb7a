"""The host's time of day is set under running processes: a loop in wall time goes on as if nothing had been.

A library between the processes and the C library sets it for them alone: the machine's own clock stays.
"""

import mmap
import os
import shutil
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from wall_loop import RATE_HZ, wall_loop

# what asks for the time of day, and only that, is told another one, and who waits until a time of day waits by it; the step
# stands in a shared file, in seconds
SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile long *step;

__attribute__((constructor)) static void begin(void) {
    int file = open(getenv("VO2_TEST_CLOCK_STEP"), O_RDONLY);
    step = mmap(0, sizeof *step, PROT_READ, MAP_SHARED, file, 0);
    close(file);
}

int clock_gettime(clockid_t which, struct timespec *at) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "clock_gettime");
    int status = real(which, at);
    if (!status && which == CLOCK_REALTIME && step) at->tv_sec += *step;
    return status;
}

int gettimeofday(struct timeval *at, void *zone) {
    struct timespec now;
    int status = clock_gettime(CLOCK_REALTIME, &now);
    at->tv_sec = now.tv_sec, at->tv_usec = now.tv_nsec / 1000;
    return status;
}

time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return at ? (*at = now.tv_sec) : now.tv_sec;
}

/* The end of a slice of 20 ms of the true time of day; 0 once `until` is over by the time of day that is told. */
static int slice(const struct timespec *until, struct timespec *end) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (now.tv_sec > until->tv_sec || (now.tv_sec == until->tv_sec && now.tv_nsec >= until->tv_nsec)) return 0;
    long nanoseconds = 20000000;
    if (until->tv_sec - now.tv_sec < 1) {
        long left = (until->tv_sec - now.tv_sec) * 1000000000 + until->tv_nsec - now.tv_nsec;
        if (left < nanoseconds) nanoseconds = left;
    }
    *end = now, end->tv_sec -= *step, end->tv_nsec += nanoseconds;
    if (end->tv_nsec >= 1000000000) end->tv_nsec -= 1000000000, end->tv_sec++;
    return 1;
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until) {
    static int (*real)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    if (!real) real = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (until->tv_sec < 1000000000) return real(condition, mutex, until);  /* of a clock that does not jump */
    struct timespec end;
    while (slice(until, &end)) {
        int status = real(condition, mutex, &end);
        if (status != ETIMEDOUT) return status;
    }
    return ETIMEDOUT;
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *until) {
    static int (*real)(pthread_mutex_t *, const struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    struct timespec end;
    while (slice(until, &end)) {
        int status = real(mutex, &end);
        if (status != ETIMEDOUT) return status;
    }
    return ETIMEDOUT;
}

int sem_timedwait(sem_t *semaphore, const struct timespec *until) {
    static int (*real)(sem_t *, const struct timespec *);
    if (!real) real = dlsym(RTLD_NEXT, "sem_timedwait");
    struct timespec end;
    while (slice(until, &end)) {
        int status = real(semaphore, &end);
        if (!status || errno != ETIMEDOUT) return status;
    }
    errno = ETIMEDOUT;
    return -1;
}
"""
UM = 1e-6


@pytest.fixture
def clock(tmp_path, monkeypatch):
    """Sets the time of day of processes that start from here on: a function that takes the step [s]."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler: the time of day cannot be set for a process alone")
    (tmp_path / "shim.c").write_text(SHIM)
    library, place = tmp_path / "shim.so", tmp_path / "step"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, tmp_path / "shim.c", "-ldl"], check=True)
    place.write_bytes(struct.pack("l", 0))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("VO2_TEST_CLOCK_STEP", str(place))
    with place.open("r+b") as file, mmap.mmap(file.fileno(), 0) as shared:

        def to(seconds):
            shared[:] = struct.pack("l", seconds)

        yield to


def test_the_library_sets_the_time_of_day_and_no_other_clock(clock):
    asked = "import sys, time; print(time.time() - float(sys.argv[1]), time.monotonic() - float(sys.argv[2]))"
    clock(-7200)
    said = subprocess.run(
        [sys.executable, "-c", asked, str(time.time()), str(time.monotonic())],
        capture_output=True,
        text=True,
        env=dict(os.environ),
    ).stdout.split()
    assert float(said[0]) == pytest.approx(-7200, abs=60) and abs(float(said[1])) < 60


def disturbance(loop, clock, step):
    """Set the time of day and watch for 3 s: the true deflections [m] meanwhile, and how long a loss of the command took.

    That time is in seconds after the setting; None where the current went on.
    """
    since = loop.samples
    clock(step)
    loop.rig.spin(3.0)
    heard = loop.rig.heard["/vo2/measurement"][since:]
    stamps = np.array([stamp for stamp, _ in heard])
    assert len(stamps) > 2.0 * RATE_HZ, f"{step} s: {len(stamps)} measurements in 3 s"
    steady = np.diff(stamps) * 1e-9 * RATE_HZ
    assert steady.min() > 0.0 and steady.max() < 0.5 * RATE_HZ, f"{step} s: the stamps follow the clock"
    off = [stamp for stamp, values in heard if values[1] <= 1e-3]
    return loop.tip(since), (off[0] - stamps[0]) * 1e-9 if off else None


@pytest.mark.alone
def test_setting_the_time_of_day_disturbs_no_loop_in_wall_time(clock, model_file, tmp_path, capfd):
    """A machine that stands still for three periods is a loss too, whatever its clock does; a second time it is the clock."""
    steps = (3600, -7200, 3)
    farthest, silent, stalls = 0.0, 0.0, 0
    with wall_loop(tmp_path, model_file) as loop:
        for step in steps:
            lost = []
            for _ in range(3):
                commands = loop.commands
                tip, after = disturbance(loop, clock, step)
                if after is None:
                    farthest = max(farthest, float(np.max(np.abs(tip - 30 * UM))))
                    silent = max(silent, loop.silence(commands))
                    break
                lost.append(f"{after:.2f}")
                loop.until_closed(loop.samples)
                clock(0)
                loop.until_closed(loop.samples)
            assert len(lost) < 3, f"{step} s: the loop took it for a loss, {', '.join(lost)} s after it"
            stalls += len(lost)
        assert all(each.process.poll() is None for each in loop.processes.values())
    with capfd.disabled():
        print(
            f"\ntime of day set by {steps} s: the tip left its set-point by at most {farthest / UM:.1f} um, a new sample was "
            f"answered after at most {silent:.1f} periods; {stalls} times the loop lost its command and the same setting did "
            "nothing the next time"
        )
    assert farthest < 4 * UM
