"""All connections to a UR controller together: what the streaming loop calls."""

import math
import select
import socket
from collections.abc import Callable, Sequence

from omniman_ros.arm import sockets
from omniman_ros.arm.feedback import ArmSample
from omniman_ros.arm.parameters import PERIOD, UrParameters
from omniman_ros.arm.program_link import WAITING, ProgramLink, ProgramState
from omniman_ros.arm.rtde_link import RtdeLink
from omniman_ros.arm.sockets import LinkError

__all__ = ["ArmLink", "LinkError", "ProgramState"]


class ArmLink:
    """Real-time data from a controller, a program to it, setpoints to the program.

    Nothing blocks but :meth:`wait`, and that ends when it was told to.

    Args:
        parameters: Where the controller is.
        clock: Gives the time, s, steady.

    Attributes:
        parameters: May be replaced; addresses, ports and the register stay those of the start.

    Raises:
        LinkError: The host has no address, or the reverse port cannot be had.
    """

    def __init__(self, parameters: UrParameters, clock: Callable[[], float]) -> None:
        self.parameters = p = parameters
        self._clock = clock
        host = sockets.address_of(p.host)
        self._rtde = RtdeLink(host, p.rtde_port, p.register)
        # What was held up as long as the program waits is sent at once.
        waiting = max(WAITING, math.ceil(p.read_timeout / PERIOD) + 4)
        self._program = ProgramLink(host, p.script_port, p.reverse_port, waiting)

    # ---- real-time data -------------------------------------------------------------------------

    @property
    def trouble(self) -> str:
        """Why no real-time data flow, or an empty string."""
        return self._rtde.trouble(self._clock(), self.parameters.feedback_timeout)

    @property
    def connected(self) -> bool:
        """Whether real-time data flow."""
        return not self.trouble

    @property
    def sample(self) -> ArmSample | None:
        """The newest usable data, however old."""
        return self._rtde.newest

    @property
    def counts(self) -> dict[str, int]:
        """Data that were dropped or skipped, by kind; see :class:`RtdeSession`."""
        return self._rtde.counts

    def take_samples(self) -> list[ArmSample]:
        """Return the usable data since the last call, oldest first."""
        result = list(self._rtde.samples)
        self._rtde.samples.clear()
        return result

    def take_texts(self) -> list[str]:
        """Return what the controller has said in words since the last call."""
        result = list(self._rtde.texts)
        self._rtde.texts.clear()
        return result

    # ---- the program ----------------------------------------------------------------------------

    @property
    def program(self) -> ProgramState:
        """State of the program."""
        return self._program.state

    @property
    def program_trouble(self) -> str:
        """Why the program is lost, or an empty string."""
        return self._program.trouble

    @property
    def calls(self) -> dict[str, int]:
        """Calls that were closed, by kind; see :class:`ProgramLink`."""
        return self._program.calls

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that the program has to call; no host before the first connection."""
        return self.parameters.reverse_host or self._rtde.local, self._program.port

    def start_program(self, text: str, now: float) -> None:
        """Send a program and await its call; see :meth:`ProgramLink.start`."""
        self._program.start(text, now, self.parameters.connect_timeout)

    def send(self, data: bytes) -> bool:
        """Send one setpoint; see :meth:`ProgramLink.send`."""
        return self._program.send(data)

    def end_program(self) -> None:
        """End the connection of the program: what was sent arrives, then FIN."""
        self._program.end()

    # ---- time -----------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """Give up what takes too long, and connect again.

        Args:
            now: Time, s, on the clock of the link.
        """
        self._rtde.tick(now, self.parameters.connect_timeout)
        self._program.tick(now)

    def wait(self, until: float, others: Sequence[int] = ()) -> list[int]:
        """Serve the connections until a time, at least once.

        Args:
            until: Time, s, on the clock of the link.
            others: File descriptors to wait for, too.

        Returns:
            Those of the others that can be read; as soon as there are some, or new data.
        """
        while True:
            readers: list[socket.socket | int] = [*others]
            readers += [*self._rtde.readers(), *self._program.readers()]
            writers = [*self._rtde.writers(), *self._program.writers()]
            left = max(until - self._clock(), 0.0)
            # not epoll: it counts in ms
            readable, writable, _ = select.select(readers, writers, [], left)
            if readable or writable:
                ready: set[socket.socket | int] = {*readable, *writable}
                self._rtde.serve(ready, self._clock())
                self._program.serve(ready)
                heard = [fd for fd in others if fd in ready]
                if heard or self._rtde.samples:
                    return heard
            if self._clock() >= until:
                return []

    def close(self) -> None:
        """Close everything."""
        self._rtde.close()
        self._program.close()
