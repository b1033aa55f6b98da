"""Publish what a simulated world tells besides the state of its drives."""

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.world import (
    contacts_message,
    fill_obstacle_markers,
    obstacle_markers,
    wheel_loads_message,
)
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_world_parameters import SimulatedWorldParameters

if TYPE_CHECKING:
    from omniman_ros.simulation.world.world import World


class WorldReportPublisher:
    """Publishes contacts, wheel_loads and ground_truth/obstacles."""

    def __init__(
        self, node: OmnimanNode, world: "World", parameters: SimulatedWorldParameters
    ) -> None:
        p = self._parameters = parameters
        self._node, self._world = node, world
        self._loads_every = max(1, round(p.state_rate / p.electrical_rate))
        self._obstacles_every = max(1, round(p.state_rate / p.obstacle_rate))
        self._contacts = node.create_publisher(DiagnosticArray, "contacts", 10)
        self._loads = node.create_publisher(Float64MultiArray, "wheel_loads", 10)
        self._obstacles = node.create_publisher(MarkerArray, "ground_truth/obstacles", 10)
        self._markers = obstacle_markers(world.obstacles, p.world_frame)
        self._count, self._is_touched = 0, False

    def publish(self, stamp: Time) -> None:
        """Publish what is due in one report."""
        p = self._parameters
        self._count += 1
        contacts = self._world.contacts
        if contacts or self._is_touched:
            self._contacts.publish(contacts_message(contacts, p.world_frame, stamp))
        self._is_touched = bool(contacts)
        if self._count % self._loads_every == 0:
            self._loads.publish(wheel_loads_message(self._world.wheel_loads))
        if self._count % self._obstacles_every == 0:
            fill_obstacle_markers(self._markers, self._world.obstacles, stamp)
            self._obstacles.publish(self._markers)
