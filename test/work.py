"""Work counted in calls of functions, which no busy machine changes."""

import gc
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any


def calls(work: Callable[[], object]) -> int:
    """Return the number of functions, of Python and of C, that a piece of work calls.

    Only calls in this thread count. An operation on a whole array is one call, or none. No garbage
    is collected meanwhile: calls of those that are told of a collection would count, too. What the
    classes of messages do inside does not count, as ROS_PYTHON_CHECK_FIELDS decides on it.
    """
    number, depth = 0, 0  # depth of the calls below one of a class of messages, with that one

    def count(frame: FrameType, event: str, _argument: Any) -> None:
        nonlocal number, depth
        if event == "call" and (depth or "/msg/_" in frame.f_code.co_filename):
            depth += 1
        elif event == "return" and depth:
            depth -= 1
        elif event in ("call", "c_call") and not depth:
            number += 1

    before = sys.getprofile()
    collects = gc.isenabled()
    gc.disable()
    sys.setprofile(count)
    try:
        work()
    finally:
        sys.setprofile(before)
        if collects:
            gc.enable()
    return number - 1  # without the second `setprofile`
