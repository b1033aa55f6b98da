"""Planning in a thread of its own."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

Plan = TypeVar("Plan")


def in_background(plan: Callable[[], Plan]) -> Future[Plan]:
    """Plan in a thread, because planning takes up to seconds and must not delay stops.

    The thread does not delay the end of the process either: it is a daemon, which runs on if its
    plan is discarded.
    """
    future: Future[Plan] = Future()

    def work() -> None:
        try:
            future.set_result(plan())
        except BaseException as error:  # raised again by `result()`
            future.set_exception(error)

    threading.Thread(target=work, name="tool_path", daemon=True).start()
    return future
