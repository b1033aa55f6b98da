"""Publishes the obstacles of the page, and applies the page's changes to them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Pose, Vector3
from rclpy.publisher import Publisher
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.planning.cases import PlanningCase, TwoVelocityPath
from omniman_ros.viewer.events import (
    ObstacleDeleted,
    ObstacleDragged,
    ObstacleMotionSet,
    ObstaclePathSet,
    ObstacleResized,
    ObstacleSelected,
    ObstacleVelocitySet,
    WaypointAdded,
)
from omniman_ros.viewer.placed_obstacles import DEFAULT_RADIUS, PlacedObstacles
from omniman_ros.viewer.view_state import ViewState

#: Namespaces for the markers, of which the first is chosen that no other viewer uses
NAMESPACES = ("viewer", *(f"viewer_{k}" for k in range(2, 10)))
MARKER_PERIOD = 0.1  #: Period of the markers [s]
MARKER_LIFETIME = 1.0  #: Lifetime of a marker, which ends if this node dies [s]
CYLINDER_HEIGHT = 0.5  #: Height of the published cylinders [m]
NEW_OBSTACLE_DISTANCE = 1.2  #: Distance of a new obstacle in front of the robot [m]
NEW_OBSTACLE_CLEARANCE = 0.15  #: Clearance between a new obstacle and the others [m]
#: Offsets to the left that are tried for a new obstacle [m], until one is clear
LATERAL_OFFSETS = tuple((k + 1) // 2 * (0.3 if k % 2 else -0.3) for k in range(60))
_COLOUR = ColorRGBA(r=0.61, g=0.21, b=0.09, a=0.8)


class ObstaclePublisher:
    """Publishes the obstacles that the page has placed on `obstacles`.

    The changes by the page raise the errors of `PlacedObstacles`.
    """

    def __init__(self, node: OmnimanNode, state: ViewState, frame: str) -> None:
        self._node = node
        self._state = state
        self._frame = frame
        self.obstacles = PlacedObstacles()  #: The obstacles
        self.namespace = ""  #: Namespace of their markers, empty before the first obstacle
        self._publisher: Publisher | None = None
        self._is_only_source = True
        self._published_numbers: set[int] = set()
        self._published_at = -math.inf
        self._other_viewers: dict[str, float] = {}
        self._ended = False

    @property
    def handlers(self) -> dict[type, Callable[[Any, float], None]]:
        """The handler of each type of event, called with the event and the time [s]."""
        return {
            ObstacleDragged: self.drag,
            ObstacleVelocitySet: self.set_velocity,
            ObstacleMotionSet: self.set_motion,
            ObstaclePathSet: self.set_path,
            WaypointAdded: self.add_waypoint,
            ObstacleResized: self.resize,
            ObstacleSelected: self.select,
            ObstacleDeleted: self.delete,
        }

    def owns(self, namespace: str) -> bool:
        """Return whether a namespace is this page's; namespaces of other viewers are recorded."""
        if namespace == self.namespace:
            return bool(namespace)
        if namespace in NAMESPACES:
            self._other_viewers[namespace] = self._node.now()
        return False

    # ---- changes by the page ------------------------------------------------------------------

    def add(self, now: float) -> None:
        """Add an obstacle in front of the robot, clear of the others."""
        x, y, theta = self._state.odom or (0.0, 0.0, 0.0)
        others = self.obstacles.arrays(now)
        radii = others.semi_axes.max(axis=1, initial=0.0)
        min_distances = DEFAULT_RADIUS + NEW_OBSTACLE_CLEARANCE + radii
        forward = np.array([math.cos(theta), math.sin(theta)])
        left = np.array([-forward[1], forward[0]])
        ahead = position = np.array([x, y]) + NEW_OBSTACLE_DISTANCE * forward
        for offset in LATERAL_OFFSETS:
            position = ahead + offset * left
            if (np.hypot(*(others.centers - position).T) >= min_distances).all():
                break
        path = TwoVelocityPath((float(position[0]), float(position[1])))
        self._state.selected_obstacle = self.obstacles.add(path, now)

    def load(self, case: PlanningCase, now: float) -> None:
        """Replace all obstacles by those of a test case, paused."""
        self.obstacles.delete(None)
        self.obstacles.restart(now)
        self.obstacles.pause(now)
        for path in case.paths:
            self.obstacles.add(path, now, (case.radius, case.radius))
        self._state.selected_obstacle = None

    def drag(self, event: ObstacleDragged, now: float) -> None:
        """Move an obstacle."""
        self.obstacles.move(event.number, event.position, now)
        self._state.selected_obstacle = event.number

    def set_velocity(self, event: ObstacleVelocitySet, now: float) -> None:
        """Set the velocity of an obstacle."""
        self.obstacles.set_velocity(event.number, event.velocity, now)

    def set_motion(self, event: ObstacleMotionSet, now: float) -> None:
        """Change the kind of motion of an obstacle."""
        self.obstacles.set_motion(event.number, event.motion, now)

    def set_path(self, event: ObstaclePathSet, now: float) -> None:
        """Set the path of an obstacle."""
        self.obstacles.set_path(event.number, event.path, now)

    def add_waypoint(self, event: WaypointAdded, now: float) -> None:
        """Append a way point to the path of the selected obstacle.

        Raises:
            InputError: The obstacle is not selected (a click on another one selects that one and
                reaches the floor as well), does not follow way points, has too many of them, or
                the position is out of range.
        """
        if event.number != self._state.selected_obstacle:
            raise InputError("no way point added: another obstacle was chosen")
        self.obstacles.add_waypoint(event.number, event.position, now)

    def resize(self, event: ObstacleResized, now: float) -> None:
        """Set the semi-axes and the heading of an obstacle."""
        self.obstacles.resize(event.number, event.semi_axes, event.angle)

    def select(self, event: ObstacleSelected, now: float) -> None:
        """Select an obstacle for editing, or none."""
        if event.number is not None:
            self._require(event.number)
        self._state.selected_obstacle = event.number

    def delete(self, event: ObstacleDeleted, now: float) -> None:
        """Delete an obstacle, or all."""
        if event.number is not None:
            self._require(event.number)
        self.obstacles.delete(event.number)

    def _require(self, number: int) -> None:
        if number not in self.obstacles:
            raise InputError(f"there is no obstacle {number}")

    # ---- output -------------------------------------------------------------------------------

    def update_state(self, now: float) -> None:
        """Write the obstacles at their present positions into the view state."""
        state = self._state
        state.obstacles = self.obstacles.arrays(now)
        state.obstacles_paused = self.obstacles.paused
        if state.selected_obstacle is not None and state.selected_obstacle not in self.obstacles:
            state.selected_obstacle = None

    def survey(self) -> None:
        """Check whether other nodes publish obstacles."""
        if self._publisher is not None:
            this_node = (self._node.get_name(), self._node.get_namespace())
            self._is_only_source = all(
                (info.node_name, info.node_namespace) == this_node
                for info in self._node.get_publishers_info_by_topic("obstacles")
            )

    def publish(self, now: float) -> None:
        """Publish present and deleted obstacles; call this once per period.

        A planner that has received obstacles does not drive once their source falls silent. So
        empty messages continue after the last obstacle is deleted, unless there is another
        source: they would hide its silence from the planner.
        """
        arrays = self.obstacles.arrays(now)
        deleted = self._published_numbers.difference(arrays.numbers.tolist())
        is_due = now - self._published_at > MARKER_PERIOD - 1e-6
        if self._ended or not (deleted or is_due):
            return
        if self._publisher is None:
            if not len(arrays.numbers):
                return
            self._publisher = self._open(now)
            self._node.final_publishers.append(self._publisher)  # its last message deletes them
        header = Header(stamp=self._node.stamp(), frame_id=self._frame)
        message = MarkerArray(markers=[self._deletion(header, n) for n in sorted(deleted)])
        if deleted and not len(arrays.numbers):
            message.markers = [self._deletion(header, None)]
        columns = (arrays.numbers, arrays.centers, arrays.semi_axes, arrays.angles)
        for row in zip(*(column.tolist() for column in columns), strict=True):
            message.markers.append(self._marker(header, *row))
        if message.markers or self._is_only_source:
            self._publisher.publish(message)
            self._published_numbers, self._published_at = set(arrays.numbers.tolist()), now

    def reset_time(self, now: float) -> None:
        """Restart all obstacles after time went back."""
        self.obstacles.restart(now)
        self._other_viewers.clear()
        self._published_at = -math.inf

    def end(self) -> None:
        """Delete all obstacles for good; nothing is published afterwards."""
        if self._publisher is not None and not self._ended:
            header = Header(stamp=self._node.stamp(), frame_id=self._frame)
            self._publisher.publish(MarkerArray(markers=[self._deletion(header, None)]))
        self.obstacles.delete(None)
        self._ended = True

    def _open(self, now: float) -> Publisher:
        """Create the publisher, with a namespace that no other viewer uses."""
        used = {
            name
            for name, received_at in self._other_viewers.items()
            if now - received_at < 2.0 * MARKER_LIFETIME
        }
        self.namespace = next((n for n in NAMESPACES if n not in used), NAMESPACES[-1])
        return self._node.create_publisher(MarkerArray, "obstacles", 10)

    def _deletion(self, header: Header, number: int | None) -> Marker:
        action = Marker.DELETEALL if number is None else Marker.DELETE
        return Marker(header=header, ns=self.namespace, id=number or 0, action=action)

    def _marker(
        self, header: Header, number: int, center: list[float], axes: list[float], angle: float
    ) -> Marker:
        return Marker(
            header=header,
            ns=self.namespace,
            id=number,
            type=Marker.CYLINDER,
            action=Marker.ADD,
            pose=Pose(
                position=Point(x=center[0], y=center[1], z=0.5 * CYLINDER_HEIGHT),
                orientation=quaternion_from_yaw(angle),
            ),
            scale=Vector3(x=2.0 * axes[0], y=2.0 * axes[1], z=CYLINDER_HEIGHT),
            color=_COLOUR,
            lifetime=Duration(
                sec=int(MARKER_LIFETIME), nanosec=round(MARKER_LIFETIME % 1.0 * 1e9)
            ),
        )
