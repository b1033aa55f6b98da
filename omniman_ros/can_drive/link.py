"""Drives and their bus together: what a node calls once a period and when something is heard."""

from collections.abc import Callable, Iterable

from omniman_ros.can_drive.bus import CanBus
from omniman_ros.can_drive.drives import CanDrives
from omniman_ros.can_drive.frame import Frame
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.robot import Robot


class CanLink:
    """A policy on an open bus.

    Args:
        robot: The robot.
        p: The installation.
        clock: Gives the time, s, steady.
        wake: Called from another thread when frames wait for :meth:`hear`, if not None.

    Attributes:
        drives: The policy.
        sent, heard: Frames so far.

    Raises:
        ParameterError: The installation does not fit the robot.
        BusError: The bus cannot be opened.
    """

    def __init__(
        self, robot: Robot, p: CanParameters, clock: Callable[[], float],
        wake: Callable[[], None] | None = None,
    ) -> None:  # fmt: skip
        self.drives = CanDrives(robot, p)
        self._period = p.period
        self._clock = clock
        self.sent = self.heard = 0
        self.bus = CanBus(p, wake)

    def hear(self) -> None:
        """Take what was heard; a stop that it asks for is sent at once."""
        for item in self.bus.take():
            if isinstance(item, str):
                self.send(self.drives.bus_failed(item, self._clock()))
                continue
            self.heard += 1
            answer = self.drives.receive(item, self._clock())
            if answer:
                self.send(answer)

    def tick(self) -> None:
        """Do one period."""
        self.hear()
        if self.bus.failure:
            self.send(self.drives.bus_failed(self.bus.failure, self._clock()))
        self.send(self.drives.tick(self._clock()))

    def send(self, frames: Iterable[Frame]) -> None:
        """Send frames; where one cannot be sent all stop, and that is tried to be sent."""
        frames = list(frames)
        self.sent += len(frames)
        failure = self.bus.send(frames)
        if failure:
            self.bus.send(self.drives.bus_failed(failure, self._clock()))

    def run_until(self, done: Callable[[], bool], timeout: float) -> bool:
        """Do periods until something is done; False if it is not in time, s."""
        now = self._clock()
        end, due = now + timeout, now
        while not done():
            now = self._clock()
            if now >= end:
                return False
            if now >= due:
                self.tick()
                due = max(due + self._period, now)
            else:
                self.bus.wait(min(due, end) - now)
                self.hear()
        return True

    def close(self) -> None:
        """Close the bus."""
        self.bus.close()
