"""What goes over a CAN bus of UDP, recorded beside the processes of a robot."""

import threading
from typing import NamedTuple

import can

from omniman_ros.can_drives.reception import enlarge_receive_buffer
from omniman_ros.processes.drive_options import MULTICAST_GROUP


class BusFrame(NamedTuple):
    """A data frame."""

    id: int
    data: bytes


class BusRecorder:
    """Records all data frames on the bus at a UDP port, in a thread of its own."""

    def __init__(self, port):
        where = {"channel": MULTICAST_GROUP, "port": port, "hop_limit": 0}
        self._bus = can.Bus(interface="udp_multicast", **where)
        enlarge_receive_buffer(self._bus)
        self.frames = []
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._record, daemon=True)
        self._thread.start()

    def _record(self):
        while not self._closing.is_set():
            try:
                message = self._bus.recv(0.1)
            except can.CanError:
                continue
            if message is not None and not message.is_remote_frame:
                self.frames.append(BusFrame(message.arbitration_id, bytes(message.data)))

    def close(self):
        """End the recording and close the bus."""
        self._closing.set()
        self._thread.join()
        self._bus.shutdown()
