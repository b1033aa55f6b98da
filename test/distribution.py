"""Distribution of the files of tests over the workers of pytest-xdist.

Tests that start processes wait for real time more than they compute. They come first in the
collection; the first worker takes files from its begin, all others take them from its end. There
is one worker more than cores, so that the cores are busy while the first one waits.
"""

import os

from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

FIRST = "gw0"  #: Name of the worker that begins with the tests with processes


def worker_count() -> int:
    """Return the number of workers on this machine."""
    return len(os.sched_getaffinity(0)) + 1


class TwoEndedScheduling(LoadFileScheduling):
    """Gives files from the begin of the collection to the first worker, from its end to others."""

    def _assign_work_unit(self, node: WorkerController) -> None:
        if node.gateway.id != FIRST:
            self.workqueue.move_to_end(next(reversed(self.workqueue)), last=False)
        super()._assign_work_unit(node)
