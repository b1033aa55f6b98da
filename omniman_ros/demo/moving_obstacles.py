"""Obstacles on straight lines, such as those that cross the robot's path in the demo."""

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple

HEIGHT = 1.0  #: Height of the cylinders [m]
NAMESPACE = "demo"  #: Namespace of the markers
DEMO_OBSTACLES = (
    (1.3, -1.9, 0.0, 0.45, 0.3),
    (2.2, 2.0, 0.0, -0.4, 0.3),
    (1.9, -0.95, 0.0, 0.0, 0.25),
)  #: Position [m], velocity [m/s] and radius [m] of the demo's obstacles, in the robot's frame


class DemoObstacles:
    """Cylinders that move at constant velocity.

    Args:
        start: ROS time at which the obstacles are at `positions` [s].
        positions: Positions (M, 2) at that time in odom [m].
        velocities: Velocities (M, 2) in odom [m/s].
        radii: Radii (M,) [m].
    """

    def __init__(self, start: float, positions: Array, velocities: Array, radii: Array) -> None:
        self._start, self._positions, self._velocities = start, positions, velocities
        self.radii = radii

    @staticmethod
    def in_front_of(robot: Triple, start: float) -> "DemoObstacles":
        """Return the demo's obstacles before a robot at a pose in odom, from a ROS time on [s]."""
        table = np.array(DEMO_OBSTACLES)
        rotation = se2.rotation(robot[2])[:2, :2]
        positions = table[:, :2] @ rotation + np.array(robot[:2])
        return DemoObstacles(start, positions, table[:, 2:4] @ rotation, table[:, 4])

    def at(self, time: float) -> Array:
        """Return the positions (M, 2) at a ROS time [s]."""
        result: Array = self._positions + (time - self._start) * self._velocities
        return result

    def message(self, time: float, stamp: Time, frame: str = "odom") -> MarkerArray:
        """Return the observation of the obstacles at a ROS time [s] by an ideal sensor."""
        rows = zip(self.at(time).tolist(), self.radii.tolist(), strict=True)
        return MarkerArray(
            markers=[
                Marker(
                    header=Header(stamp=stamp, frame_id=frame),
                    ns=NAMESPACE,
                    id=k,
                    type=Marker.CYLINDER,
                    pose=Pose(
                        position=Point(x=x, y=y, z=0.5 * HEIGHT), orientation=Quaternion(w=1.0)
                    ),
                    scale=Vector3(x=2.0 * radius, y=2.0 * radius, z=HEIGHT),
                    color=ColorRGBA(r=0.85, g=0.3, b=0.1, a=0.9),
                )
                for k, ((x, y), radius) in enumerate(rows)
            ]
        )

    @staticmethod
    def removal_message() -> MarkerArray:
        """Return the message that removes the obstacles."""
        return MarkerArray(markers=[Marker(ns=NAMESPACE, action=Marker.DELETEALL)])
