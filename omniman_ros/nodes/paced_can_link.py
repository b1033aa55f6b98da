"""The drives' end of a simulated bus in simulated time."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_clock import SimulatedClock
from omniman_ros.simulation.can_link.records import BusFrame, Instant, Record
from omniman_ros.simulation.can_link.server import CanLinkServer
from omniman_ros.simulation.link_connection import SimulationLinkError

if TYPE_CHECKING:  # needs python-can, which is optional
    import can

PARTICIPANT = "the host of the bus"  #: Name under which simulated time waits for the bridge


class PacedCanLink:
    """Passes frames between simulated drives and a bridge, and lets time pass as both come along.

    Simulated time makes its next step when the bridge is done with the last one. A bridge that
    sends anything but records is disconnected with a warning.

    Raises:
        ParameterError: The port is not available.
    """

    def __init__(self, node: OmnimanNode, port: int, step: float, clock: SimulatedClock) -> None:
        self._node, self._lookahead, self._clock = node, 1.5 * step, clock
        self._server = CanLinkServer(port)
        self._refused = 0
        node.get_logger().info(f"the drives wait for their host at port {self._server.port}")

    @property
    def port(self) -> int:
        """Number of the port."""
        return self._server.port

    def receive(self) -> "list[can.Message]":
        """Return the frames that have arrived, after noting how far the bridge has come."""
        if self._server.accept():
            self._node.get_logger().info(f"{PARTICIPANT} is connected")
            self.send((), self._node.now())
        if self._server.refused > self._refused:
            self._refused = self._server.refused
            self._node.warn("second host", "a second host of the bus is refused")
        try:
            records = self._server.receive()
        except (SimulationLinkError, InputError) as error:
            self._on_loss(error)
            return []
        for record in records:
            if isinstance(record, Instant):
                self._clock.permit(PARTICIPANT, record.time + self._lookahead)
        return [_message(record) for record in records if isinstance(record, BusFrame)]

    def send(self, messages: "Iterable[can.Message]", now: float | None = None) -> None:
        """Send frames, and the instant up to which all have been sent [s], if that is reached."""
        records: list[Record] = [
            BusFrame(m.arbitration_id, bytes(m.data), m.is_extended_id, m.is_remote_frame)
            for m in messages
        ]
        if now is not None:
            records.append(Instant(now))
        if not records:
            return
        try:
            self._server.send(records)
        except SimulationLinkError as error:
            self._on_loss(error)

    def _on_loss(self, error: Exception) -> None:
        self._node.warn("host", f"{PARTICIPANT} is disconnected: {error}")
        self._clock.leave(PARTICIPANT)

    def close(self) -> None:
        """Close the port."""
        self._server.close()


def _message(frame: BusFrame) -> "can.Message":
    """Return a frame as a message of python-can."""
    import can

    return can.Message(
        arbitration_id=frame.id,
        data=frame.data,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
    )
