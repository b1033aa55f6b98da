"""The protocols that drives may speak: one line each."""

from collections.abc import Callable
from dataclasses import dataclass

from omniman_ros.can_drive.axis import Axis, AxisSettings, Network, QuietNetwork
from omniman_ros.can_drive.cia402 import CanopenNetwork, Cia402Axis
from omniman_ros.can_drive.odrive import OdriveAxis
from omniman_ros.can_drive.vesc import VescAxis


@dataclass(frozen=True)
class ProtocolEntry:
    """What makes the axes of a protocol, and what the bus carries besides.

    Attributes:
        axis: Makes the axis of one drive.
        network: Makes the rest, for all drives of the bus.
    """

    axis: Callable[[AxisSettings], Axis]
    network: Callable[[tuple[AxisSettings, ...]], Network] = lambda settings: QuietNetwork()


PROTOCOLS = {
    "cia402": ProtocolEntry(Cia402Axis, CanopenNetwork),
    "vesc": ProtocolEntry(VescAxis),
    "odrive": ProtocolEntry(OdriveAxis),
}
"""Value of `can.protocol` to what speaks it."""
