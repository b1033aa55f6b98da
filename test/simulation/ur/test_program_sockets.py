"""Connections of programs: what they may read in a cycle, and in cycles that were missed."""

import socket

import pytest

from omniman_ros.simulation.ur.program_sockets import ProgramSockets

SIZE = 32  #: Size of a message [bytes]


class Rig:
    """A connection that a program has opened to a peer."""

    def __init__(self):
        self.network = ProgramSockets()
        with socket.create_server(("127.0.0.1", 0)) as server:
            assert self.network.open("127.0.0.1", server.getsockname()[1], "peer")
            self.peer, _ = server.accept()

    def send(self, count):
        self.peer.sendall(bytes(SIZE) * count)

    def take(self):
        """Return how many messages the program can read in this cycle."""
        count = 0
        while self.network.take("peer", SIZE):
            count += 1
        return count


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.peer.close()
    rig.network.close_all()


def test_punctual_cycle_reads_all_that_has_arrived(rig):
    rig.send(5)
    rig.network.admit(1)
    assert rig.take() == 5


@pytest.mark.parametrize("arrived", [1, 9, 10, 25])
def test_what_arrived_is_spread_evenly_over_missed_cycles(rig, arrived):
    rig.send(arrived)
    counts = []
    for due_cycles in range(10, 0, -1):
        rig.network.admit(due_cycles)
        counts.append(rig.take())
    assert sum(counts) == arrived
    assert max(counts) - min(counts) <= 1


def test_message_is_read_whole_although_its_bytes_are_admitted_in_parts(rig):
    rig.peer.sendall(bytes(range(SIZE)))
    rig.network.admit(2)
    assert rig.network.take("peer", SIZE) == b""
    rig.network.admit(1)
    assert rig.network.take("peer", SIZE) == bytes(range(SIZE))


def test_end_of_a_connection_is_noticed_in_a_missed_cycle(rig):
    rig.peer.close()
    rig.network.admit(10)
    assert rig.network.take("peer", SIZE) is None


@pytest.mark.parametrize("host", ["a\0b", "\ud800", "a" * 400])
def test_what_is_no_address_is_not_connected(host):
    assert not ProgramSockets().open(host, 80, "peer")


def test_connection_that_is_opened_again_has_no_old_share(rig):
    rig.send(1)
    rig.network.admit(10)
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert rig.network.open("127.0.0.1", server.getsockname()[1], "peer")
        peer, _ = server.accept()
    with peer:
        peer.sendall(bytes(3 * SIZE))
        assert rig.take() == 3
