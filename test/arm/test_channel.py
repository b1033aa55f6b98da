"""Messages between a node and its streaming process, over a pair of sockets."""

import socket

import numpy as np
import pytest

from omniman_ros.arm.channel import BUFFER, Channel, ChannelError


@pytest.fixture
def pair():
    ends = [Channel(sock) for sock in socket.socketpair()]
    yield ends
    for end in ends:
        end.close()


def test_messages_arrive_whole_and_in_order(pair):
    ours, theirs = pair
    for k in range(5):
        ours.send((k, "word"))
    assert theirs.receive() == [(k, "word") for k in range(5)]
    assert theirs.receive() == []


def test_a_message_that_is_larger_than_the_buffers_arrives_whole():
    sender, receiver = socket.socketpair()
    ours, theirs = Channel(sender), Channel(receiver)
    sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)  # the least that there is
    large = np.random.default_rng(7).random(BUFFER // 8)
    ours.send(large)
    ours.send("after it")
    heard = []
    for _ in range(10_000):
        heard += theirs.receive()
        if len(heard) == 2:
            break
        ours.send("more")
    assert (heard[0] == large).all()
    assert heard[1] == "after it"
    ours.close()
    theirs.close()


def test_a_message_that_is_cut_anywhere_is_put_together():
    raw, sock = socket.socketpair()
    sender, receiver = socket.socketpair()
    ours, theirs, reader = Channel(sender), Channel(receiver), Channel(sock)
    ours.send(["message", 1.5])
    data = receiver.recv(1000)
    for cut in range(1, len(data)):
        raw.sendall(data[:cut])
        assert reader.receive() == []
        raw.sendall(data[cut:])
        assert reader.receive() == [["message", 1.5]]
    for end in (raw, ours, theirs, reader):
        end.close()


def test_nobody_waits_for_a_side_that_does_not_read(pair):
    ours, _ = pair
    with pytest.raises(ChannelError, match="reads nothing"):
        for _ in range(100):
            ours.send(bytes(BUFFER // 4))


def test_what_was_sent_before_the_end_still_arrives(pair):
    ours, theirs = pair
    ours.send("last")
    ours.shut()
    assert theirs.receive() == ["last"]
    with pytest.raises(ChannelError, match="gone: closed"):
        theirs.receive()
    with pytest.raises(ChannelError, match="gone"):
        theirs.send("to nobody")


def test_shutting_ends_a_wait_of_ones_own(pair):
    ours, _ = pair
    ours.shut()
    with pytest.raises(ChannelError):
        ours.wait_and_receive()


def test_what_there_was_no_room_for_is_sent_by_a_flush():
    ours, theirs = (Channel(end) for end in socket.socketpair())
    large = b"x" * (3 * BUFFER // 2)
    ours.send(large)
    ours.send("stop")
    heard = []
    for _ in range(100):
        heard += theirs.receive()
        ours.flush()
    assert heard == [large, "stop"]
