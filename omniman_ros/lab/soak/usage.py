"""What processes use over time: memory, descriptors, threads and CPU time."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.lab.measurement import cpu_time

MEBIBYTE = 2**20  #: bytes in a mebibyte
#: Fraction of the samples, the later ones, from which growth is computed: caches fill at first
SETTLED_FRACTION = 0.5


@dataclass(frozen=True)
class Usage:
    """What a process uses at one time."""

    at: float  #: time [s]
    pid: int  #: process id: a process that was started anew begins anew
    memory: float  #: resident memory [MiB]
    descriptors: int  #: number of open file descriptors
    threads: int  #: number of threads
    cpu: float  #: CPU time used so far [s]


def usage(pid: int, at: float) -> Usage | None:
    """Return what a process uses; None if it has ended."""
    folder = Path(f"/proc/{pid}")
    try:
        pages = int((folder / "statm").read_text().split()[1])
        descriptors = len(os.listdir(folder / "fd"))
        threads = len(os.listdir(folder / "task"))
        cpu = cpu_time(pid)
    except (OSError, CommandError):
        return None
    if not pages:
        return None  # it has ended, and its parent does not know yet
    memory = pages * os.sysconf("SC_PAGE_SIZE") / MEBIBYTE
    return Usage(at, pid, memory, descriptors, threads, cpu)


def usage_figures(samples: Sequence[Usage]) -> dict[str, Any]:
    """Return the figures of the life of a process that was not started anew."""
    first, last = samples[0], samples[-1]
    settled = samples[int(len(samples) * (1.0 - SETTLED_FRACTION)) :]
    elapsed = last.at - first.at
    growth = np.nan
    if len(settled) >= 3:
        times = np.array([sample.at for sample in settled])
        memory = np.array([sample.memory for sample in settled])
        growth = 3600.0 * float(np.polyfit(times - times[0], memory, 1)[0])
    return {
        "seconds": elapsed,
        "cpu_share": (last.cpu - first.cpu) / elapsed if elapsed > 0.0 else np.nan,
        "memory_MiB": last.memory,
        "memory_growth_MiB_per_hour": growth,
        "descriptors": last.descriptors,
        "descriptors_growth": last.descriptors - settled[0].descriptors,
        "threads": last.threads,
        "threads_growth": last.threads - settled[0].threads,
    }


def longest_life(samples: Sequence[Usage]) -> list[Usage]:
    """Return the samples of the process id that has most of them."""
    lives: dict[int, list[Usage]] = {}
    for sample in samples:
        lives.setdefault(sample.pid, []).append(sample)
    return max(lives.values(), key=len, default=[])
