"""Which tests may run side by side.

Tests of the command and of nodes as processes of their own watch real time: they run one by one
(`-m processes`). All others are spun on simulated time and run on all cores (`-n auto`).
"""

import os
from pathlib import Path

import pytest

from omniman_ros.cli import isolation

HERE = Path(__file__).parent
PROCESSES = {HERE / "test_processes.py", HERE / "test_viewer_browser.py"}

# Each worker has domains of its own; those of test/nodes/harness.py lie in between.
WORKER = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:])
WORKERS = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
isolation.SELDOM_USED = isolation.SELDOM_USED[WORKER::WORKERS]
isolation.USUAL = range(1, 40)[WORKER::WORKERS]


def pytest_collection_modifyitems(items):
    for item in items:
        if PROCESSES & {item.path, *item.path.parents}:
            item.add_marker(pytest.mark.processes)
