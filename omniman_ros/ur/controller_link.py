"""All connections to a UR controller, as the streaming loop uses them."""

import math
import select
import socket
from collections.abc import Callable, Sequence

from omniman_ros.ur import sockets
from omniman_ros.ur.feedback import ArmSample
from omniman_ros.ur.parameters import PERIOD, UrParameters
from omniman_ros.ur.program_link import MAX_UNACKNOWLEDGED, ProgramLink, ProgramState
from omniman_ros.ur.rtde_link import RtdeLink


class ControllerLink:
    """Connections for real-time data, for the program, and for its setpoints.

    No method blocks except :meth:`wait`, which ends at a given time.

    Attributes:
        parameters: Addresses, ports and timeouts. They may be replaced; addresses, ports and the
            register then keep their old values.

    Raises:
        LinkError: The host has no address, or the reverse port is not available.
    """

    def __init__(self, parameters: UrParameters, clock: Callable[[], float]) -> None:
        self.parameters = p = parameters
        self._clock = clock
        host = sockets.address_of(p.host)
        self._rtde = RtdeLink(host, p.rtde_port, p.register)
        # After a delay as long as the program's timeout, all missed setpoints are sent at once.
        max_unacknowledged = max(MAX_UNACKNOWLEDGED, math.ceil(p.read_timeout / PERIOD) + 4)
        self._program = ProgramLink(host, p.script_port, p.reverse_port, max_unacknowledged)

    @property
    def blocking_reason(self) -> str:
        """Why no real-time data flow, or an empty string."""
        return self._rtde.blocking_reason(self._clock(), self.parameters.feedback_timeout)

    @property
    def connected(self) -> bool:
        """Whether real-time data flow."""
        return not self.blocking_reason

    @property
    def sample(self) -> ArmSample | None:
        """Newest usable data, of any age; None before the first."""
        return self._rtde.newest

    @property
    def counts(self) -> dict[str, int]:
        """Number of data that were dropped or skipped, by kind; see :class:`RtdeSession`."""
        return self._rtde.counts

    def take_samples(self) -> list[ArmSample]:
        """Return the usable data since the last call, oldest first."""
        result = list(self._rtde.samples)
        self._rtde.samples.clear()
        return result

    def take_texts(self) -> list[str]:
        """Return the text messages of the controller since the last call."""
        result = list(self._rtde.texts)
        self._rtde.texts.clear()
        return result

    @property
    def program(self) -> ProgramState:
        """State of the program."""
        return self._program.state

    @property
    def program_loss_reason(self) -> str:
        """Why the program is lost, or an empty string."""
        return self._program.loss_reason

    @property
    def refused_connections(self) -> dict[str, int]:
        """Number of refused connections, by kind; see :class:`ProgramLink`."""
        return self._program.refused_connections

    @property
    def address(self) -> tuple[str, int]:
        """Local address and port for the program; no address before the first connection."""
        return self.parameters.reverse_host or self._rtde.local, self._program.port

    def start_program(self, text: str, now: float) -> None:
        """Send a program and await its connection; see :meth:`ProgramLink.start`."""
        self._program.start(text, now, self.parameters.connect_timeout)

    def send(self, data: bytes) -> bool:
        """Send one setpoint; see :meth:`ProgramLink.send`."""
        return self._program.send(data)

    def end_program(self) -> None:
        """End the connection of the program; data already sent still arrive, followed by FIN."""
        self._program.end()

    def tick(self, now: float) -> None:
        """Give up connections that do not answer until `now` [s], and reconnect."""
        self._rtde.tick(now, self.parameters.connect_timeout)
        self._program.tick(now)

    def wait(self, until: float, others: Sequence[int] = ()) -> list[int]:
        """Serve the connections until a time on the link's clock [s], at least once.

        Returns:
            The readable ones of `others`. The method returns early if there are any, or if new
            data have arrived.
        """
        while True:
            readers: list[socket.socket | int] = [*others]
            readers += [*self._rtde.readers(), *self._program.readers()]
            writers = [*self._rtde.writers(), *self._program.writers()]
            remaining = max(until - self._clock(), 0.0)
            # epoll is no alternative, as its timeouts are whole milliseconds.
            readable, writable, _ = select.select(readers, writers, [], remaining)
            if readable or writable:
                ready: set[socket.socket | int] = {*readable, *writable}
                self._rtde.serve(ready, self._clock())
                self._program.serve(ready)
                readable_others = [fd for fd in others if fd in ready]
                if readable_others or self._rtde.samples:
                    return readable_others
            if self._clock() >= until:
                return []

    def close(self) -> None:
        """Close all connections."""
        self._rtde.close()
        self._program.close()
