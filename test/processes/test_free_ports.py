"""Free TCP ports."""

import socket

from omniman_ros.processes.free_ports import are_free, find_free_ports


def test_a_port_in_use_is_not_free_and_free_ports_differ():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert not are_free([port])
    assert are_free([port])
    numbers = find_free_ports(5)
    assert len(set(numbers)) == 5
