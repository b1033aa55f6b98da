import os
import signal

import pytest

from omniman_ros.lab.bench import guests


@pytest.mark.processes
def test_a_guest_that_hangs_is_ended(monkeypatch):
    monkeypatch.setattr(guests, "LONGEST_LIFE", 0.05)
    monkeypatch.setattr(guests.rclpy, "init", lambda args: signal.pause())
    child = os.fork()
    if child == 0:
        guests.stay(0, 0.0)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status)
    assert os.WTERMSIG(status) == signal.SIGALRM
