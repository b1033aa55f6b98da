"""Measurement of CPU time, statistics of measured times, and samples of measured rows."""

import math
import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.core.arrays import Array

#: Environment variables that restrict numerical libraries to one thread.
#:
#: Helper threads that spin would add to the CPU time. The libraries read the variables when they
#: are loaded.
SINGLE_THREADED = {
    f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR", "VECLIB_MAXIMUM")
}


def cpu_time(pid: int) -> float:
    """Return the CPU time, user and system, that all threads of a process have used so far [s]."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError as error:
        raise CommandError(f"CPU time of process {pid}: {error} (this needs Linux)") from error
    # The second field, the name in parentheses, may itself contain blanks and parentheses.
    fields = text.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cpu_fractions(pids: Mapping[str, int], serve: Callable[[], None]) -> dict[str, float]:
    """Return the CPU time over the elapsed time of processes while a function runs, by name."""
    start = time.monotonic()
    before = {name: cpu_time(pid) for name, pid in pids.items()}
    serve()
    after = {name: cpu_time(pid) for name, pid in pids.items()}
    elapsed = time.monotonic() - start
    return {name: (after[name] - before[name]) / elapsed for name in pids}


def median_cpu(work: Callable[[], object], repeats: int) -> float:
    """Return the median CPU time of a function call in this process [s]."""
    times = []
    for _ in range(repeats):
        before = time.process_time()
        work()
        times.append(time.process_time() - before)
    return statistics.median(times)


def best_cpu(work: Callable[[], object], min_block_time: float) -> float:
    """Return the CPU time of a function call in this process [s].

    It is the mean over a block of calls, the smallest of three blocks.
    """
    best = math.inf
    for _ in range(3):
        calls, begin = 0, time.process_time()
        while (taken := time.process_time() - begin) < min_block_time or not calls:
            work()
            calls += 1
        best = min(best, taken / calls)
    return best


def spread_ms(seconds: Sequence[float]) -> dict[str, float]:
    """Return the median, the 99th percentile and the maximum of times [ms]; NaN without any."""
    values = 1e3 * np.percentile(np.asarray(seconds or [np.nan]), (50.0, 99.0, 100.0))
    return dict(zip(("median_ms", "p99_ms", "max_ms"), values.tolist(), strict=True))


def columns_at(rows: Array, times: Array) -> Array:
    """Return the columns after the time, (n, c) at times (n,), by linear interpolation."""
    return np.column_stack([np.interp(times, rows[:, 0], column) for column in rows[:, 1:].T])
