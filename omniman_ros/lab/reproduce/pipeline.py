"""The steps that all experiments share: drive with a progress bar, draw, report, publish."""

import time
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from omniman_ros.console import results
from omniman_ros.console.progress import Progress
from omniman_ros.console.terminal import say

T = TypeVar("T")


def collect(progress: Progress, part: str, made: Iterable[T], count: int, unit: str) -> list[T]:
    """Collect results that are made one after the other, and show the progress.

    Args:
        progress: Progress bar.
        part: Name of the part that is shown.
        made: The results.
        count: Number of the results.
        unit: What a result is called, in the plural.
    """
    collected: list[T] = []
    progress.begin(part)
    for item in made:
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
    """Complete a result with the time it took, print its report, and publish it as JSON.

    Args:
        name: Name of the results.
        result: The result; `took_s` is added.
        report: Makes the lines of the report from the result.
        started: Begin of the experiment on the monotonic clock [s].
        folder: Folder of the results.

    Raises:
        OSError: The folder cannot be written.
    """
    result["took_s"] = time.monotonic() - started
    say("\n".join(report(result)))
    results.publish(name, result, folder)
