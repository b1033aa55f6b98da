from collections import OrderedDict
from types import SimpleNamespace

import pytest

pytest.importorskip("xdist")
from test.distribution import FIRST, TwoEndedScheduling

FILES = ["a.py", "b.py", "c.py", "d.py", "e.py"]


class Worker:
    """A worker that records the indices of the tests that it is given."""

    def __init__(self, name):
        self.gateway = SimpleNamespace(id=name)
        self.given = []

    def send_runtest_some(self, indices):
        self.given.extend(indices)


def test_the_first_worker_takes_files_from_the_begin_and_the_others_from_the_end():
    first, second, third = workers = [Worker(FIRST), Worker("gw1"), Worker("gw2")]
    scheduling = TwoEndedScheduling.__new__(TwoEndedScheduling)
    scheduling.workqueue = OrderedDict((file, {f"{file}::test": False}) for file in FILES)
    scheduling.assigned_work = {}
    tests = [f"{file}::test" for file in FILES]
    scheduling.registered_collections = dict.fromkeys(workers, tests)
    for node in (*workers, second, first):
        scheduling._assign_work_unit(node)
    assert not scheduling.workqueue
    assert (first.given, second.given, third.given) == ([0, 1], [4, 2], [3])
