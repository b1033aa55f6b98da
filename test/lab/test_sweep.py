"""A sweep's results do not depend on where they are computed, or on processes that die."""

import importlib
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from omniman_ros.console.errors import CommandError
from omniman_ros.lab import sweep
from omniman_ros.lab.sweep import Sweep

START_UP = 60.0  #: Time that scheduler and workers have to start [s]


def process_of(item):
    """Return a process and an item."""
    return os.getpid(), item


def die_once(folder, item):
    """Kill this process for one of the items, once."""
    mark = Path(folder, "died")
    if item == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


def die(item):
    """Kill this process."""
    os.kill(os.getpid(), signal.SIGKILL)


def fail(item):
    """Raise an error for an item."""
    if item == 2:
        raise ValueError(f"no drive {item}")
    return item


def sleep_long(folder, item):
    """Sleep for longer than a test takes, once an item is said to be under way."""
    Path(folder, f"begun_{item}").touch()
    time.sleep(2.0 * START_UP)


def threads(item):
    """Return how many threads numerical libraries may use."""
    return os.environ["OMP_NUM_THREADS"]


@pytest.mark.processes
def test_items_are_shared_among_processes_and_results_keep_their_order():
    results = list(Sweep(2).map(process_of, range(6)))
    assert [item for _, item in results] == list(range(6))
    assert os.getpid() not in {pid for pid, _ in results} and len({p for p, _ in results}) <= 2
    assert list(Sweep(1).map(threads, [0])) == ["1"]


@pytest.mark.processes
def test_process_that_dies_costs_its_drive_only(tmp_path, capsys):
    assert Sweep(2).collect(partial(die_once, str(tmp_path)), range(6)) == [0, 1, 4, 9, 16, 25]
    said = capsys.readouterr().out
    assert said.count("computed again") == 1 and "the process of 3" in said
    assert "6 drives" in said


@pytest.mark.processes
def test_drive_that_ends_each_process_is_named(capsys):
    with pytest.raises(CommandError, match=f"7 has ended {sweep.ATTEMPTS} processes"):
        list(Sweep(1).map(die, [7]))


@pytest.mark.processes
def test_error_of_a_drive_is_that_of_the_sweep():
    with pytest.raises(ValueError, match="no drive 2"):
        list(Sweep(2).map(fail, range(5)))


@pytest.mark.processes
def test_interrupt_ends_all_processes(tmp_path):
    program = (
        "from functools import partial\n"
        "from omniman_ros.lab.sweep import Sweep\n"
        "from test.lab.test_sweep import sleep_long\n"
        f"list(Sweep(2).map(partial(sleep_long, {str(tmp_path)!r}), range(6)))\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", program],
        start_new_session=True,
        # A shell ignores the signal in what it starts in the background.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + START_UP
    while len(list(tmp_path.iterdir())) < 2:
        assert time.monotonic() < deadline and child.poll() is None
        time.sleep(0.05)
    os.killpg(child.pid, signal.SIGINT)
    assert child.wait(START_UP) != 0
    assert len(list(tmp_path.iterdir())) == 2


def test_usage_errors_are_reported(monkeypatch):
    with pytest.raises(CommandError, match="--jobs must be 1 or more, got 0") as error:
        Sweep(0)
    assert error.value.code == 2
    monkeypatch.setattr(sweep.CLUSTER.__class__, "is_available", False)
    with pytest.raises(CommandError, match=r"pip install.*distributed"):
        Sweep(1, "tcp://127.0.0.1:1")


# ---- a cluster ----------------------------------------------------------------------------------


def started(*words, **environment):
    """Start a part of a cluster."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *words],
        env={**os.environ, **environment},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


@pytest.fixture
def cluster(tmp_path):
    """Return the address of a scheduler, and a function that starts a worker."""
    pytest.importorskip("distributed")
    where = tmp_path / "scheduler.json"
    options = ["--scheduler-file", str(where), "--no-dashboard"]
    parts = [started("scheduler", *options, "--host", "127.0.0.1", "--port", "0")]

    def worker(threads_of_libraries="1"):
        words = ("--scheduler-file", str(where), "--nthreads", "1", "--no-nanny", "--no-dashboard")
        parts.append(started("worker", *words, OMP_NUM_THREADS=threads_of_libraries))
        return parts[-1]

    deadline = time.monotonic() + START_UP
    while not where.exists():
        assert time.monotonic() < deadline and parts[0].poll() is None
        time.sleep(0.05)
    yield json.loads(where.read_text())["address"], worker
    for part in parts:
        if part.poll() is None:
            os.killpg(part.pid, signal.SIGKILL)
        part.wait()


def slow_square(folder, item):
    """Return a square, once an item is said to be under way."""
    Path(folder, f"begun_{item}").touch()
    time.sleep(0.3)
    return item * item


@pytest.mark.processes
def test_cluster_gives_the_same_though_a_worker_dies(tmp_path, cluster):
    address, worker = cluster
    first, _ = worker(), worker()
    with importlib.import_module("distributed").Client(address) as client:
        client.wait_for_workers(2, START_UP)
    results = Sweep(1, address).map(partial(slow_square, str(tmp_path)), range(12))
    found = [next(results)]
    os.killpg(first.pid, signal.SIGKILL)
    assert [*found, *results] == [k * k for k in range(12)]
    assert first.wait() == -signal.SIGKILL


@pytest.mark.processes
def test_cluster_that_would_give_other_results_is_refused(monkeypatch, cluster):
    address, worker = cluster
    monkeypatch.setattr(sweep, "CONNECTING", 1.0)
    with pytest.raises(CommandError, match="the cluster has no workers"):
        list(Sweep(1, address).map(abs, [1]))
    worker("4")
    monkeypatch.setattr(sweep, "CONNECTING", START_UP)
    with pytest.raises(CommandError, match="OMP_NUM_THREADS 4"):
        list(Sweep(1, address).map(abs, [1]))


def test_silent_cluster_is_an_error(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(sweep, "CONNECTING", 0.5)
    with pytest.raises(CommandError, match=r"--dask tcp://127\.0\.0\.1:9"):
        list(Sweep(1, "tcp://127.0.0.1:9").map(abs, [1]))
