"""The rig of `omniman bench can` leaves nothing behind where it cannot start."""

import socket
import threading
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from omniman_ros.lab.bench import can_rig
from omniman_ros.lab.bench.harness import free_ports
from omniman_ros.processes.process_group import ProcessGroup
from test.running import is_alive

pytestmark = pytest.mark.processes


def test_drives_and_recorder_end_if_the_bridge_cannot_start(monkeypatch):
    commands = {"simulated_can_drives": ("sleep", "99"), "can_bridge": ("/nowhere/command",)}
    monkeypatch.setattr(can_rig, "node_command", lambda node, arguments: commands[node])
    pids = []

    class Group(ProcessGroup):
        def __enter__(self):
            entered = super().__enter__()
            pids.append(self.pid("simulated_can_drives"))
            return entered

    monkeypatch.setattr(can_rig, "ProcessGroup", Group)
    (port,) = free_ports(1, socket.SOCK_DGRAM)
    session = SimpleNamespace(node=MagicMock())
    before = set(threading.enumerate())
    rig = can_rig.Rig(session, "cia402", port, lambda name, line: None)
    with pytest.raises(FileNotFoundError, match="/nowhere/command"), rig:
        pass
    assert len(pids) == 1 and not is_alive(pids[0])
    session.node.destroy_timer.assert_called_once()
    recorders = [thread for thread in threading.enumerate() if "_record" in thread.name]
    assert before.issuperset(recorders)
