"""One simulated drive on a bus, whatever it speaks."""

from typing import Protocol

import can

from omniman_ros.drive.can.motor import DriveFaults


class BusDrive(Protocol):
    """Firmware of one drive: frames in, frames out, and a motor. Time is an argument, in s.

    When it is made it takes the power off its motor.

    Attributes:
        faults: Faults to play, changed from outside at any time.
    """

    faults: DriveFaults

    def receive(self, message: can.Message, now: float) -> list[can.Message]:
        """Hear a frame from the bus, of whatever sender and kind; return what it answers."""

    def advance(self, now: float) -> list[can.Message]:
        """Run timers and watchdogs up to a time; return what is due to be sent.

        It is called often, at least every 2 ms of `now` where the caller can.
        """
