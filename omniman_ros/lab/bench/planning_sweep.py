"""Drives of the planner in parallel processes, and the statistics of their cycles."""

import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from omniman_ros.lab.measurement import SINGLE_THREADED, percentiles_ms

R = TypeVar("R")  # result of a drive


def sweep(drive: Callable[..., R], tasks: Sequence[tuple[Any, ...]], jobs: int) -> list[R]:
    """Return the results of drives, in the order of the tasks.

    Each process has one thread, so that CPU times are those of the planner.
    """
    os.environ.update(SINGLE_THREADED)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        waiting = [pool.submit(drive, *task, time.process_time) for task in tasks]
        return [each.result() for each in waiting]


def cycle_figures(times: Sequence[Sequence[float]]) -> dict[str, float]:
    """Return the CPU time of cycles [ms]: over all drives, and the worst drive's percentile."""
    median, p99, largest = percentiles_ms([taken for drive in times for taken in drive])
    worst = max(percentiles_ms(drive)[1] for drive in times)
    return {"median": median, "p99": p99, "worst_p99": worst, "max": largest}
