"""The receive buffer of a bus over UDP, on sockets of this machine, and errors of reading."""

import socket
from pathlib import Path

import can
import pytest

from omniman_ros.can_drives.bus import CanBus
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.reception import RECEIVE_BUFFER, is_invalid_frame
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.nodes.can_receiver import open_bus
from omniman_ros.processes.drive_options import MULTICAST_GROUP

#: Largest buffer that this machine grants [bytes]
GRANTED = int(Path("/proc/sys/net/core/rmem_max").read_text())
#: Frames of a second: four drives, two reports and a setpoint each, 100 times a second
SECOND = 1200


@pytest.fixture
def parameters():
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    return CanParameters(
        interface="udp_multicast", channel=MULTICAST_GROUP, port=port, nodes=(1, 2, 3, 4)
    )


def size(descriptor):
    """Return the size of a socket's buffer, which Linux reports doubled [bytes]."""
    with socket.fromfd(descriptor, socket.AF_INET, socket.SOCK_DGRAM) as own:
        return own.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


@pytest.mark.processes
def test_bridge_and_simulated_drives_ask_for_the_buffer(parameters):
    bridge, drives = CanBus(parameters), open_bus(parameters)
    try:
        sizes = [size(bridge._bus.fileno()), size(drives.fileno())]
        assert sizes == [min(RECEIVE_BUFFER, GRANTED)] * 2
    finally:
        bridge.close()
        drives.shutdown()


@pytest.mark.skipif(GRANTED < RECEIVE_BUFFER, reason="net.core.rmem_max is smaller")
@pytest.mark.processes
def test_frames_of_a_second_wait_for_a_reader_that_waits_for_a_core(parameters):
    bridge, drives = CanBus(parameters), open_bus(parameters)
    try:
        for number in range(SECOND):
            data = number.to_bytes(8, "little")
            drives.send(can.Message(arbitration_id=0x281, data=data, is_extended_id=False))
        received = []
        while frames := list(bridge.take()):
            received += frames
        expected = [CanFrame(0x281, number.to_bytes(8, "little")) for number in range(SECOND)]
        assert received == expected
    finally:
        bridge.close()
        drives.shutdown()


def can_error(cause=None):
    error = can.CanError("a frame was not received")
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "is_invalid"),
    [
        (OSError("the interface is down"), False),
        (can_error(), False),
        (can_error(OSError("the interface is down")), False),
        (can_error(ValueError("an id of 40 bits")), True),
        (ValueError("an id of 40 bits"), True),
    ],
)
def test_an_invalid_frame_is_no_failure_of_the_bus(error, is_invalid):
    assert is_invalid_frame(error) is is_invalid
