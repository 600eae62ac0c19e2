"""Tasks of the parallel tests, in a module that worker processes can import."""

from __future__ import annotations

import os
import signal
import time

import numpy as np

from pcnde_bridge._utils import workers


def work(seed):
    """Return a result that depends on every bit of the seed's random numbers."""
    numbers = np.random.default_rng(seed).standard_normal(100)
    return {"numbers": numbers, "sum": float(numbers.sum()), "where": {"seed": seed}}


def fail_until(task):
    """Fail the number of times that the task gives; the count is in a file."""
    path, times, error = task
    done = len(path.read_text()) if path.exists() else 0
    path.write_text("x" * (done + 1))
    if done < times:
        raise error
    return done


def kill_once(task):
    """Kill this process the first time, or every time."""
    path, often = task
    if path is None:
        time.sleep(0.2)  # so that the pool breaks while this runs
        return os.getpid()
    if often or not path.exists():
        path.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def nproc(_):
    return os.environ.get("NPROC")


def sleep_unless_last(task):
    """Sleep, or end the run once the other one sleeps."""
    path, last, interrupt = task
    if not last:
        path.write_text(str(os.getpid()))
        time.sleep(600)
    while not (path.exists() and path.read_text()):
        time.sleep(0.02)
    if interrupt:
        os.kill(os.getppid(), signal.SIGINT)
        time.sleep(600)
    return "no mapping, so it cannot be stored"


def slowly(task):
    """Report the worker, and take long enough to be killed."""
    seed, folder = task
    (folder / f"{os.getpid()}-{seed}").touch()
    time.sleep(0.3)
    return work(seed)


def held_parts():
    """Return how many parts this worker process holds."""
    return sum(map(len, workers._held.values()))
