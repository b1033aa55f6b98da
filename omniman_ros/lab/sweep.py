"""The same drive for many inputs: in processes of this machine, or on a Dask cluster."""

import argparse
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, TypeVar

from omniman_ros.console.errors import CommandError
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say
from omniman_ros.extras import CLUSTER
from omniman_ros.lab.measurement import SINGLE_THREADED

Item = TypeVar("Item")
Result = TypeVar("Result")

ATTEMPTS = 3  #: Number of processes that may end with an input before it is given up
CONNECTING = 10.0  #: Time within which a cluster must answer [s]


@dataclass(frozen=True)
class Sweep:
    """Where drives are computed. Their results do not depend on it.

    Each process has one thread, so that CPU times are those of the drive. One that dies costs its
    drive only, which is computed again.
    """

    jobs: int  #: Number of processes on this machine
    cluster: str = ""  #: Address of the scheduler of a Dask cluster to use instead; empty for none

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise CommandError(f"--jobs must be 1 or more, got {self.jobs}", code=2)
        if self.cluster and not CLUSTER.is_available:
            raise CommandError(CLUSTER.hint)

    @staticmethod
    def of(args: argparse.Namespace) -> "Sweep":
        """Return what `--jobs` and `--dask` ask for."""
        jobs = os.cpu_count() or 1 if args.jobs is None else args.jobs
        return Sweep(jobs, args.dask or "")

    @staticmethod
    def here() -> "Sweep":
        """Return processes on all cores of this machine."""
        return Sweep(os.cpu_count() or 1)

    @property
    def conditions(self) -> dict[str, Any]:
        """What a result says of where its drives were computed."""
        return {"jobs": self.jobs} if not self.cluster else {"jobs": None, "cluster": True}

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """Yield the results of a function that can be pickled, in the order of the items.

        Raises:
            CommandError: The cluster cannot be used, or an item has ended `ATTEMPTS` processes.
        """
        if self.cluster:
            return _on_cluster(function, items, self.cluster)
        return _in_processes(function, items, min(self.jobs, len(items)))

    def collect(self, function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
        """Return the results of `map`, and show the progress meanwhile."""
        progress, found = Progress(), list[Result]()
        progress.begin("drives")
        for result in self.map(function, items):
            found.append(result)
            progress.update(len(found) / len(items), f"{len(found)} of {len(items)}")
        progress.end(f"{len(found)} drives")
        return found


def _in_processes(
    function: Callable[[Item], Result], items: Sequence[Item], jobs: int
) -> Iterator[Result]:
    # Numerical libraries read these when they are loaded: in the new processes.
    os.environ.update(SINGLE_THREADED)
    own, opened = threading.local(), list[ProcessPoolExecutor]()
    is_ending = threading.Event()

    def computed(item: Item) -> Result:
        for _ in range(ATTEMPTS):
            if is_ending.is_set():
                break
            process = _own_process(own, opened)
            try:
                return process.submit(function, item).result()
            except KeyboardInterrupt:  # of the process: no other drive is to begin
                is_ending.set()
                raise
            except BrokenProcessPool:
                own.process = None
                if not is_ending.is_set():
                    say(f"the process of {item} has died: it is computed again")
        raise CommandError(f"{item} has ended {ATTEMPTS} processes")

    # A thread for each process, as a pool of several breaks as a whole when one dies.
    threads = ThreadPoolExecutor(max(jobs, 1))
    try:
        yield from threads.map(computed, items)
    except BaseException:  # Ctrl-C, an error of a drive, or nobody wants the rest
        is_ending.set()
        threads.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        threads.shutdown(cancel_futures=True)
        for pool in opened:
            pool.shutdown(cancel_futures=True)


def _own_process(own: threading.local, opened: list[ProcessPoolExecutor]) -> ProcessPoolExecutor:
    """Return the process of a thread, which is a new one if it has none."""
    if getattr(own, "process", None) is None:
        # A new interpreter: forking a process that may have threads is not safe.
        own.process = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
        opened.append(own.process)
    process: ProcessPoolExecutor = own.process
    return process


def _on_cluster(
    function: Callable[[Item], Result], items: Sequence[Item], address: str
) -> Iterator[Result]:
    from distributed import Client, KilledWorker  # an extra

    try:
        client = Client(address, timeout=CONNECTING, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise CommandError(f"--dask {address}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECTING)
        except TimeoutError as error:
            raise CommandError(f"--dask {address}: the cluster has no workers") from error
        _require_alike(client.run(_about_worker))
        try:
            futures = client.map(function, items, pure=False)
            while futures:
                yield futures.pop(0).result()
        except KilledWorker as error:
            raise CommandError(f"a drive has ended several workers: {error}") from error


def _about_worker() -> tuple[str, str | None]:
    return version("omniman_ros"), os.environ.get("OMP_NUM_THREADS")


def _require_alike(workers: dict[str, tuple[str, str | None]]) -> None:
    """Check that all workers of a cluster compute as this machine does."""
    own = version("omniman_ros")
    for name, (installed, threads) in workers.items():
        if installed != own:
            raise CommandError(f"--dask: {name} has omniman_ros {installed}, expected {own}")
        if threads != "1":
            raise CommandError(
                f"--dask: {name} has OMP_NUM_THREADS {threads}, on which results depend: start it "
                "with OMP_NUM_THREADS=1 and --nthreads 1"
            )
