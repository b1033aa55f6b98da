"""A UR controller scripted by the test, byte by byte, following the RTDE guide."""

import os
import socket
import struct
from dataclasses import fields, replace

from omniman_ros.ur.parameters import UrParameters

HOST = "127.0.0.1"
NAMES = (
    b"timestamp,actual_q,actual_qd,target_q,actual_current,robot_mode,safety_mode,runtime_state,"
    b"speed_scaling,target_speed_fraction,output_int_register_24"
)
TYPES = b"DOUBLE,VECTOR6D,VECTOR6D,VECTOR6D,VECTOR6D,INT32,INT32,UINT32,DOUBLE,DOUBLE,INT32"
ASK_VERSION = b"\x00\x05V\x00\x02"
VERSION = b"\x00\x04V\x01"
NO_VERSION = b"\x00\x04V\x00"
ASK_OUTPUTS = b"\x00\x9fO" + b"\x40\x5f\x40\x00\x00\x00\x00\x00" + NAMES
OUTPUTS = b"\x00\x55O\x01" + TYPES
ASK_START = b"\x00\x03S"
START = b"\x00\x04S\x01"
NO_START = b"\x00\x04S\x00"
Q = (0.1, -1.5, 1.25, -0.3, 0.4, -6.2)
QD = (0.01, -0.02, 0.03, -0.04, 0.05, -0.06)
TARGET = (0.2, -1.4, 1.35, -0.2, 0.5, -6.1)
CURRENT = (1.0, -2.0, 0.5, 0.1, 0.2, 0.3)


def outputs(types, number=1):
    """Return the answer to the set-up of outputs."""
    return struct.pack(">HBB", 4 + len(types), ord("O"), number) + types


def data(
    timestamp,
    q=Q,
    qd=QD,
    target=TARGET,
    current=CURRENT,
    modes=(7, 1, 2),
    scaling=1.0,
    fraction=1.0,
    read=0,
    number=1,
):
    """Return a data packet of the requested outputs."""
    return struct.pack(
        ">HBBd6d6d6d6diiIddi",
        236,
        ord("U"),
        number,
        timestamp,
        *q,
        *qd,
        *target,
        *current,
        *modes,
        scaling,
        fraction,
        read,
    )


def text(words, source=b"RTDE", level=2):
    """Return a text message packet."""
    payload = bytes([len(words)]) + words + bytes([len(source)]) + source + bytes([level])
    return struct.pack(">HB", 3 + len(payload), ord("M")) + payload


class Clock:
    """A clock that stands still until the test sets its time."""

    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


def listener(host=HOST, receive_buffer=None):
    """Return a socket that listens on a free port."""
    sock = socket.socket()
    if receive_buffer is not None:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    sock.bind((host, 0))
    sock.listen()
    sock.settimeout(10)
    return sock


def closed_port():
    """Return a port without a listener."""
    with listener() as sock:
        return sock.getsockname()[1]


def reset(sock):
    """Close a connection with RST."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()


class Peer:
    """A peer that listens on the ports of a controller."""

    def __init__(self):
        self.rtde, self.script = listener(), listener()
        self.open = [self.rtde, self.script]

    def parameters(self, **changes):
        """Return the client parameters for this peer."""
        assert set(changes) <= {field.name for field in fields(UrParameters)}
        return replace(
            UrParameters(
                rtde_port=self.rtde.getsockname()[1],
                script_port=self.script.getsockname()[1],
                reverse_port=0,
            ),
            **changes,
        )

    def take(self, what):
        """Return the next connection to a listener."""
        sock, _ = what.accept()
        sock.settimeout(10)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.open.append(sock)
        return sock

    def call(self, port, source=HOST, receive_buffer=None):
        """Connect to the reverse port as the program does."""
        sock = socket.socket()
        self.open.append(sock)
        sock.settimeout(10)
        if receive_buffer is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        sock.bind((source, 0))
        sock.connect((HOST, port))
        return sock

    def close(self):
        for sock in self.open:
            sock.close()


def read(sock, size):
    """Read exactly `size` bytes."""
    result = b""
    while len(result) < size:
        part = sock.recv(size - len(result))
        assert part, result
        result += part
    return result


def turns(link, clock, done, most=1_000_000):
    """Let the link serve its sockets until a condition holds, without advancing its clock."""
    for turn in range(most):
        if done():
            return
        link.wait(clock.now)
        if turn > 50:
            os.sched_yield()
    raise AssertionError("it did not happen")
