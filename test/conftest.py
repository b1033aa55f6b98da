"""Tiers of the tests, and what all of them share.

* Tests without a mark run on injected or simulated time, on all cores.
* `processes` starts processes, sockets or threads, which run on real time.
* `exhaustive` runs by hand only (`make test-all`): tours of every parameter, whole studies.

`command` is on what tries `omniman`; `.ci/run ros` leaves its processes out.
"""

import gc
import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from omniman_ros.processes.ros_domain import free_domain
from test import shared_memory

# Seeded, without a database or wall time: the same examples on every machine.
settings.register_profile(
    "seeded",
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("seeded")

END_TO_END = f"{Path(__file__).parent}/end_to_end/"
COMMANDS = tuple(
    f"{Path(__file__).parent}/{room}/"
    for room in ("cli", "demo", "identification", "lab", "processes")
)

# A shell without job control starts background jobs with SIGINT ignored, and what the tests start
# would inherit that: none would hear the Ctrl-C that a test sends.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

NICENESS = 5  #: Niceness of all workers but the first, which begins with what runs on real time

WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])


def pytest_sessionstart():
    """Remove what killed participants of earlier runs have left: discovery waits for it."""
    shared_memory.remove_abandoned()
    if WORKER > 0:
        os.nice(NICENESS)


def pytest_collection_modifyitems(items):
    for item in items:
        if str(item.path).startswith(END_TO_END):
            item.add_marker(pytest.mark.processes)
        if str(item.path).startswith(COMMANDS):
            item.add_marker(pytest.mark.command)
    items.sort(key=lambda item: item.get_closest_marker("processes") is None)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect thousands of items without searching them for garbage, then or later."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers():
    from test import distribution

    return distribution.worker_count()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Distribute the files of the whole suite; other distributions are those of pytest-xdist."""
    from test import distribution

    whole = config.getvalue("dist") == "loadfile"
    return distribution.TwoEndedScheduling(config, log) if whole else None


@pytest.fixture(autouse=True, scope="session")
def problems_built_once():
    """Let planners share their optimisation problems; see `test/transcriptions.py`."""
    if "omniman_ros.planning.plan_optimizer" not in sys.modules:
        yield  # no test of this session has a planner
        return
    from test import transcriptions

    with pytest.MonkeyPatch.context() as patch:
        transcriptions.fraction(patch)
        yield


@pytest.fixture
def own_domain(monkeypatch):
    """Put this process, and what it starts, into a ROS domain of the test's own."""
    domain = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return domain
