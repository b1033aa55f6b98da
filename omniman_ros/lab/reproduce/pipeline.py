"""Steps that all experiments share: collecting results with a progress bar, and publishing."""

import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from omniman_ros.console import results
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say

T = TypeVar("T")


def collect(progress: Progress, part: str, items: Iterable[T], count: int, unit: str) -> list[T]:
    """Collect results that are computed one after the other, and show the progress.

    Args:
        progress: Progress bar.
        part: Name of this part of the experiment, for the progress bar.
        items: The results, usually from a generator.
        count: Number of the results.
        unit: Noun for the results in the plural, such as "drives".

    Returns:
        The results, in their order.
    """
    collected: list[T] = []
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
    """Add the duration to a result, print its report, and publish it as JSON.

    Args:
        name: Name of the results, without a suffix.
        result: The result; the duration `took_s` is added to it.
        report: Function that formats the result as lines of text.
        started: Time at which the experiment began, on the monotonic clock [s].
        folder: Folder of the results.

    Raises:
        OSError: The folder cannot be written to.
    """
    result["took_s"] = time.monotonic() - started
    say("\n".join(report(result)))
    results.publish(name, result, folder)
