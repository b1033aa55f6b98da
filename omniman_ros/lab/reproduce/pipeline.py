"""Steps that all experiments share: collecting results with a progress bar, and publishing."""

import multiprocessing
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

from omniman_ros.console import results
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say

Item = TypeVar("Item")
Result = TypeVar("Result")


def result_name(experiment: str, wheels: str | None = None) -> str:
    """Return the name of the results, without a suffix; `wheels` of the physics world or None."""
    return f"reproduce_{experiment}_{wheels}" if wheels else f"reproduce_{experiment}"


def in_parallel(
    function: Callable[[Item], Result], items: Sequence[Item], workers: int
) -> Iterator[Result]:
    """Yield the results of a function that can be pickled for items, in their order.

    With one worker, the function runs in this process.
    """
    if workers == 1:
        yield from map(function, items)
        return
    # Each worker is a new interpreter: forking a process that may have threads is not safe.
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"))
    try:
        yield from pool.map(function, items)
    finally:
        pool.shutdown(cancel_futures=True)


def collect(
    progress: Progress, part: str, items: Iterable[Item], count: int, unit: str
) -> list[Item]:
    """Return results that are computed one after the other, and show the progress meanwhile."""
    collected: list[Item] = []
    progress.begin(part)
    for item in items:
        collected.append(item)
        progress.update(len(collected) / count, f"{len(collected)} of {count}")
    progress.end(f"{len(collected)} {unit}")
    return collected


def publish(
    name: str,
    result: dict[str, Any],
    report: Callable[[dict[str, Any]], list[str]],
    started: float,
    folder: str,
) -> None:
    """Add the duration `took_s` to a result, print its report, and publish it as JSON."""
    result["took_s"] = time.monotonic() - started
    say("\n".join(report(result)))
    results.publish(name, result, folder)
