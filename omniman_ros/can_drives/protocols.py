"""Table of the drive protocols that the bridge supports.

To add a protocol, write one module with an `axis.Axis` and, if the bus carries more than the
frames of the single axes, a `Network`; then add a line to :data:`PROTOCOLS`.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Protocol

from omniman_ros.can_drives.axis import Axis, AxisSettings
from omniman_ros.can_drives.cia402.axis import Cia402Axis
from omniman_ros.can_drives.cia402.network import CanopenNetwork
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.odrive import OdriveAxis
from omniman_ros.can_drives.vesc import VescAxis


class Network(Protocol):
    """Frames of the host that belong to no single axis."""

    #: Whether the drives measure when they receive the last frame of a period (SYNC), rather than
    #: when they report.
    samples_at_sync: bool
    #: Ids, and whether they are extended, of frames that only a host sends
    command_ids: Collection[tuple[int, bool]]

    def before(self, now: float) -> list[CanFrame]:
        """Return the frames to send before those of the axes, once per period."""

    def after(self, now: float) -> list[CanFrame]:
        """Return the frames to send after those of the axes, once per period."""


@dataclass
class QuietNetwork:
    """A network without frames of its own: the bus carries only those of the axes."""

    samples_at_sync: bool = False
    command_ids: Collection[tuple[int, bool]] = field(default_factory=tuple)

    def before(self, now: float) -> list[CanFrame]:
        """Return an empty list."""
        return []

    def after(self, now: float) -> list[CanFrame]:
        """Return an empty list."""
        return []


@dataclass(frozen=True)
class ProtocolEntry:
    """Factories of one protocol."""

    axis: Callable[[AxisSettings], Axis]  #: Creates the axis of one drive
    #: Creates the network of all drives on the bus
    network: Callable[[tuple[AxisSettings, ...]], Network] = lambda settings: QuietNetwork()


PROTOCOLS = {
    "cia402": ProtocolEntry(Cia402Axis, CanopenNetwork),
    "vesc": ProtocolEntry(VescAxis),
    "odrive": ProtocolEntry(OdriveAxis),
}  #: Factories by value of the parameter `can.protocol`
