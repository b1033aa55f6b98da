"""The node's handle of a real streaming process with a silent controller."""

import os
import signal
import socket
import threading
import time

import pytest

from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.streaming_messages import StreamingCommand, StreamingPhase
from omniman_ros.ur.streaming_process import StreamingProcess

pytestmark = pytest.mark.processes  # checks real time

PATIENCE = 20.0


def parameters(reverse_port=0):
    with socket.create_server(("127.0.0.1", 0)) as free:
        closed = free.getsockname()[1]
    return UrParameters(rtde_port=closed, script_port=closed, reverse_port=reverse_port)


def start(**options):
    return StreamingProcess(ArmParameters(), parameters(**options))


def until(process, done):
    end = time.monotonic() + PATIENCE
    reports = []
    while not done():
        assert time.monotonic() < end
        process.wait(0.05)
        reports += process.take()
    return reports


@pytest.fixture
def process():
    made = start()
    yield made
    made.close()


def test_process_reports_by_itself_and_ends_when_closed(process):
    woken = []
    process._wake = lambda: woken.append(threading.current_thread())
    reports = until(process, lambda: process.report.blocking_reason == "connection refused")
    assert reports[-1] is process.report
    assert process.report.phase is StreamingPhase.IDLE and not process.report.connected
    assert woken and threading.main_thread() not in woken
    process.close()
    assert process._process.returncode == 0
    assert not process._reader.is_alive()


def test_signals_to_the_node_do_not_reach_the_process(process):
    until(process, lambda: process.report.blocking_reason == "connection refused")
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(process._process.pid, number)
    process.send(StreamingCommand.STOP, "still there")
    until(process, lambda: process.report.stop_reason == "still there")
    assert os.getsid(process._process.pid) == process._process.pid, (
        "Ctrl-C does not reach the process"
    )


def test_killed_process_is_reported_and_gets_no_messages(process):
    until(process, lambda: process.report.blocking_reason == "connection refused")
    process._process.kill()
    until(process, lambda: process.failure)
    assert process.failure == "the streaming process has ended"
    process.send(StreamingCommand.FINISH)
    assert process.failure == "the streaming process has ended"


def test_unavailable_resource_is_reported_as_failure():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        process = start(reverse_port=port)
        until(process, lambda: process.failure)
        process.close()
    assert process.failure == f"ur.reverse_port = {port} is not available: address already in use"
    assert process._process.returncode == 1


def test_hanging_process_is_killed_at_once(process):
    until(process, lambda: process.report.blocking_reason == "connection refused")
    os.kill(process._process.pid, signal.SIGSTOP)
    wait, waits = process._process.wait, []
    process._process.wait = lambda timeout=None: waits.append(timeout) or wait(timeout)
    process.close(kill=True)
    assert waits == [0.0, None]
    assert process._process.returncode == -signal.SIGKILL


def test_controller_without_an_address_is_reported_as_failure():
    process = StreamingProcess(ArmParameters(), UrParameters(host="not a host", reverse_port=0))
    until(process, lambda: process.failure)
    process.close()
    assert "ur.host 'not a host' has no address" in process.failure
