"""Messages between a node and its streaming process over a pair of sockets."""

import socket

import numpy as np
import pytest

from omniman_ros.ur.process_channel import BUFFER_SIZE, ProcessChannel, ProcessChannelError


@pytest.fixture
def pair():
    ends = [ProcessChannel(sock) for sock in socket.socketpair()]
    yield ends
    for end in ends:
        end.close()


def test_messages_arrive_whole_and_in_order(pair):
    ours, theirs = pair
    for k in range(5):
        ours.send((k, "word"))
    assert theirs.receive() == [(k, "word") for k in range(5)]
    assert theirs.receive() == []


def test_message_larger_than_the_buffers_arrives_whole():
    sender, receiver = socket.socketpair()
    ours, theirs = ProcessChannel(sender), ProcessChannel(receiver)
    sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)  # the smallest possible buffer
    large = np.random.default_rng(7).random(BUFFER_SIZE // 8)
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


def test_message_split_anywhere_is_reassembled():
    raw, sock = socket.socketpair()
    sender, receiver = socket.socketpair()
    ours, theirs, reader = ProcessChannel(sender), ProcessChannel(receiver), ProcessChannel(sock)
    ours.send(["message", 1.5])
    data = receiver.recv(1000)
    for cut in range(1, len(data)):
        raw.sendall(data[:cut])
        assert reader.receive() == []
        raw.sendall(data[cut:])
        assert reader.receive() == [["message", 1.5]]
    for end in (raw, ours, theirs, reader):
        end.close()


def test_sending_to_a_side_that_does_not_read_does_not_block(pair):
    ours, _ = pair
    with pytest.raises(ProcessChannelError, match="does not read"):
        for _ in range(100):
            ours.send(bytes(BUFFER_SIZE // 4))


def test_messages_sent_before_the_end_still_arrive(pair):
    ours, theirs = pair
    ours.send("last")
    ours.shut_down()
    assert theirs.receive() == ["last"]
    with pytest.raises(ProcessChannelError, match="ended: closed"):
        theirs.receive()
    with pytest.raises(ProcessChannelError, match="ended"):
        theirs.send("to nobody")


def test_shutting_down_ends_the_own_wait(pair):
    ours, _ = pair
    ours.shut_down()
    with pytest.raises(ProcessChannelError):
        ours.wait_and_receive()


def test_flush_sends_messages_that_did_not_fit():
    ours, theirs = (ProcessChannel(end) for end in socket.socketpair())
    large = b"x" * (3 * BUFFER_SIZE // 2)
    ours.send(large)
    ours.send("stop")
    heard = []
    for _ in range(100):
        heard += theirs.receive()
        ours.flush()
    assert heard == [large, "stop"]
