import os
import socket

import can
import pytest

from omniman_ros.lab.bench.can_peer import open_bus
from omniman_ros.lab.bench.harness import free_ports

pytestmark = pytest.mark.processes


def test_bus_joins_those_of_this_machine_and_no_others():
    (port,) = free_ports(1, socket.SOCK_DGRAM)
    with open_bus(port) as one, open_bus(port) as other:
        one.send(can.Message(arbitration_id=0x123, data=b"abc", is_extended_id=False))
        received = other.recv(5.0)
        assert received is not None
        assert (received.arbitration_id, received.data) == (0x123, b"abc")
        with socket.socket(fileno=os.dup(one.fileno())) as sends:
            # With this time to live a packet does not leave its host.
            assert sends.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
