"""Publish what a simulated world tells besides the state of its drives."""

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.world import (
    contacts_message,
    obstacle_markers,
    scan_message,
    scanner_transform,
    wheel_loads_message,
)
from omniman_ros.nodes.imu_publisher import STATIC
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_world_parameters import SimulatedWorldParameters
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters

if TYPE_CHECKING:
    from omniman_ros.simulation.world.world import World

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the wheels on PyPI
    TFMessage = None


class WorldReportPublisher:
    """Publishes scan, contacts, wheel_loads, ground_truth/obstacles and the scanner's transform.

    Args:
        node: Node that owns the publishers.
        world: The world.
        parameters: Parameters of the node.
    """

    def __init__(
        self, node: OmnimanNode, world: "World", parameters: SimulatedWorldParameters
    ) -> None:
        p = self._parameters = parameters
        self._node, self._world = node, world
        self._loads_every = max(1, round(p.state_rate / p.electrical_rate))
        self._scan_every = max(1, round(p.state_rate / p.scan_rate))
        self._scan = node.create_publisher(LaserScan, "scan", 5)
        self._contacts = node.create_publisher(DiagnosticArray, "contacts", 10)
        self._loads = node.create_publisher(Float64MultiArray, "wheel_loads", 10)
        self._obstacles = node.create_publisher(MarkerArray, "ground_truth/obstacles", 10)
        self._tf = node.create_publisher(TFMessage, "/tf_static", STATIC) if TFMessage else None
        if self._tf is None:
            node.get_logger().info(
                "tf2_msgs is not installed: /tf_static is off, scanner.* is the scanner's pose"
            )
        self._count, self._is_touched = 0, False
        self.mount(p.scanner)

    def mount(self, scanner: ScannerParameters) -> None:
        """Measure with a scanner from now on; its noise begins anew.

        Args:
            scanner: Parameters of the scanner.
        """
        # Here, so that a machine without the engine can import this module.
        from omniman_ros.simulation.world.scanner import Scanner

        p = self._parameters
        self._scanner_parameters = scanner
        self._scanner = Scanner(self._world, scanner, p.seed)
        if self._tf is not None:
            transform = scanner_transform(
                scanner, p.base_frame, p.scanner_frame, self._node.stamp()
            )
            self._tf.publish(TFMessage(transforms=[transform]))

    def publish(self, stamp: Time) -> None:
        """Publish what is due in one report.

        Args:
            stamp: Stamp of the messages.
        """
        p = self._parameters
        self._count += 1
        contacts = self._world.contacts
        if contacts or self._is_touched:
            self._contacts.publish(contacts_message(contacts, p.world_frame, stamp))
        self._is_touched = bool(contacts)
        if self._count % self._loads_every == 0:
            self._loads.publish(wheel_loads_message(self._world.wheel_loads))
        if self._count % self._scan_every == 0:
            obstacles = self._world.obstacles
            self._obstacles.publish(obstacle_markers(obstacles, p.world_frame, stamp))
            period = self._scan_every / p.state_rate
            ranges = self._scanner.scan()
            message = scan_message(
                ranges, self._scanner_parameters, period, p.scanner_frame, stamp
            )
            self._scan.publish(message)
