"""Publish what the drives on a CAN bus report."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, UInt32MultiArray

from omniman_ros.conversions.wheels import electrical_message, restarts_message, states_message
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import LATCHED

if TYPE_CHECKING:
    from omniman_ros.can_drives.link import CanLink


class WheelReportPublisher:
    """Publishes `wheel_states`, `wheel_electrical` and `wheel_restarts`."""

    def __init__(self, node: OmnimanNode, wheel_names: Sequence[str]) -> None:
        self._node, self._wheel_names = node, list(wheel_names)
        self._states = node.create_publisher(JointState, "wheel_states", 5)
        self._electrical = node.create_publisher(Float64MultiArray, "wheel_electrical", 10)
        self._restarts = node.create_publisher(UInt32MultiArray, "wheel_restarts", LATCHED)
        self._published_restarts: tuple[int, ...] = ()

    def publish(self, link: "CanLink", is_active: bool) -> None:
        """Publish new restarts of the drives and, while the node is active, the wheels' states."""
        if link.drives.restarts != self._published_restarts:
            self._published_restarts = link.drives.restarts
            self._restarts.publish(restarts_message(self._published_restarts))
        states = link.take_states()
        if states is not None and is_active:
            stamp = self._node.stamp(states.at)
            self._states.publish(states_message(self._wheel_names, states, stamp))

    def publish_electrical(self, link: "CanLink", dt: float) -> None:
        """Publish the motors' voltages, currents and energies, which grow over `dt` [s]."""
        self._electrical.publish(electrical_message(link.electrical(dt)))
