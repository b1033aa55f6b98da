"""The two ends of the link on loopback sockets, which never block."""

import socket

import pytest

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.simulation.arm_link.client import ArmLinkClient
from omniman_ros.simulation.arm_link.frames import ArmSetpoint, ArmState, encode_setpoint
from omniman_ros.simulation.arm_link.server import ArmLinkServer
from omniman_ros.simulation.link_connection import SimulationLinkError

SIX = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
TIMEOUT = 5.0


@pytest.fixture
def server():
    server = ArmLinkServer(0)
    yield server
    server.close()


@pytest.fixture
def client(server):
    client = ArmLinkClient(server.port)
    assert client.open() and client.is_open
    assert server.accept() and server.is_connected
    yield client
    client.close("the test is over")


def read(server):
    """Receive setpoints; the kernel may need a moment to deliver."""
    server._connection.wait(TIMEOUT)
    return server.receive()


def test_setpoints_and_states_arrive(server, client):
    assert server.receive() == [] and client.receive() == []
    setpoints = [ArmSetpoint(k, 0.1 * k, SIX, SIX, braked=k == 2) for k in (1, 2)]
    for setpoint in setpoints:
        client.send(setpoint)
    received = read(server)
    assert received == setpoints or received + read(server) == setpoints
    state = ArmState(2, SIX, SIX, SIX)
    server.send(state)
    assert client.wait(TIMEOUT)
    assert client.receive() == [state]


def test_nobody_listens():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        client = ArmLinkClient(taken.getsockname()[1])
        assert not client.open() and not client.is_open
        assert "no world at port" in client.failure
        assert client.receive() == []


def test_a_port_in_use_is_refused_by_name(server):
    with pytest.raises(ParameterError, match="arm_port"):
        ArmLinkServer(server.port)


def test_a_second_controller_is_turned_away(server, client):
    second = ArmLinkClient(server.port)
    assert second.open()
    assert not server.accept() and server.refused == 1
    second.wait(TIMEOUT)
    assert second.receive() == [] and not second.is_open
    assert "closed" in second.failure or "broke" in second.failure
    client.send(ArmSetpoint(1, 0.0, SIX, SIX))
    assert len(read(server)) == 1


def test_the_end_of_either_side_is_noticed_and_a_new_controller_is_accepted(server, client):
    client.close("done")
    with pytest.raises(SimulationLinkError, match="closed"):
        read(server)
    assert not server.is_connected and server.receive() == []
    again = ArmLinkClient(server.port)
    assert again.open() and server.accept()
    server.disconnect()
    again.wait(TIMEOUT)
    assert again.receive() == [] and not again.is_open
    again.send(ArmSetpoint(1, 0.0, SIX, SIX))


def test_garbage_disconnects_and_a_frame_cut_in_two_does_not(server):
    frame = encode_setpoint(ArmSetpoint(1, 0.0, SIX, SIX))
    with socket.create_connection(("127.0.0.1", server.port)) as raw:
        assert server.accept()
        raw.sendall(frame[:50])
        assert read(server) == []
        raw.sendall(frame[50:])
        assert len(read(server)) == 1
        raw.sendall(b"GET / HTTP/1.1\r\n\r\n")
        with pytest.raises(InputError, match="a frame begins with"):
            read(server)
    assert not server.is_connected


def test_a_controller_that_does_not_read_is_disconnected(server, client):
    state = ArmState(1, SIX, SIX, SIX)
    with pytest.raises(SimulationLinkError, match="does not read"):
        for _ in range(200_000):
            server.send(state)
    assert not server.is_connected
