"""Obstacles on straight lines, such as those that cross the robot's path in the demo."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.planning.obstacles.separation import box_gap

HEIGHT = 1.0
"""Height of the cylinders [m]."""
NAMESPACE = "demo"
"""Namespace of the markers."""
DEMO_OBSTACLES = (
    (1.3, -1.9, 0.0, 0.45, 0.3),
    (2.2, 2.0, 0.0, -0.4, 0.3),
    (1.9, -0.95, 0.0, 0.0, 0.25),
)
"""Position [m], velocity [m/s] and radius [m] of the demo's obstacles, in the robot's frame."""


class ObstaclesOverTime(ABC):
    """Discs whose places are known at all times.

    Attributes:
        radii: Radii (M,) [m].
    """

    def __init__(self, radii: Array) -> None:
        self.radii = radii

    @abstractmethod
    def at(self, time: float) -> Array:
        """Return the positions (M, 2) at a ROS time [s]."""

    def gaps(self, rows: Array, half_size: Sequence[float]) -> Array:
        """Return the gaps (K, M) between the robot's box and the obstacles [m].

        Args:
            rows: Rows (K, 4): ROS time and pose x, y, theta of the robot in odom.
            half_size: Half length and half width of the box [m].
        """
        centers = np.array([self.at(time) for time in rows[:, 0].tolist()])
        box = Rectangles.centred(np.array(half_size))
        axes = np.broadcast_to(self.radii[:, None], (len(rows), len(self.radii), 2))
        return box_gap(rows[:, 1:4], box, centers, axes, np.zeros(len(self.radii)))


class MovingObstacles(ObstaclesOverTime):
    """Cylinders that move at constant velocity.

    Args:
        start: ROS time at which the obstacles are at `positions` [s].
        positions: Positions (M, 2) at that time in odom [m].
        velocities: Velocities (M, 2) in odom [m/s].
        radii: Radii (M,) [m].
    """

    def __init__(self, start: float, positions: Array, velocities: Array, radii: Array) -> None:
        super().__init__(radii)
        self._start, self._positions, self._velocities = start, positions, velocities

    @staticmethod
    def in_front_of(robot: Triple, start: float) -> "MovingObstacles":
        """Return the obstacles of the demo, placed relative to the robot.

        Args:
            robot: Pose of the robot in odom [m, m, rad].
            start: ROS time at which the obstacles start [s].
        """
        table = np.array(DEMO_OBSTACLES)
        rotation = se2.rotation(robot[2])[:2, :2]
        positions = table[:, :2] @ rotation + np.array(robot[:2])
        return MovingObstacles(start, positions, table[:, 2:4] @ rotation, table[:, 4])

    def at(self, time: float) -> Array:
        """Return the positions (M, 2) at a ROS time [s]."""
        result: Array = self._positions + (time - self._start) * self._velocities
        return result

    def message(self, time: float, stamp: Time, frame: str = "odom") -> MarkerArray:
        """Return the observation of the obstacles by an ideal sensor.

        Args:
            time: ROS time of the observation [s].
            stamp: Stamp of the markers.
            frame: Frame of the markers.
        """
        header = Header(stamp=stamp, frame_id=frame)
        return MarkerArray(
            markers=[
                Marker(
                    header=header,
                    ns=NAMESPACE,
                    id=k,
                    type=Marker.CYLINDER,
                    action=Marker.ADD,
                    pose=Pose(
                        position=Point(x=x, y=y, z=0.5 * HEIGHT), orientation=Quaternion(w=1.0)
                    ),
                    scale=Vector3(x=2.0 * radius, y=2.0 * radius, z=HEIGHT),
                    color=ColorRGBA(r=0.85, g=0.3, b=0.1, a=0.9),
                )
                for k, ((x, y), radius) in enumerate(
                    zip(self.at(time).tolist(), self.radii.tolist(), strict=True)
                )
            ]
        )

    @staticmethod
    def removal_message() -> MarkerArray:
        """Return the message that removes the obstacles."""
        return MarkerArray(markers=[Marker(ns=NAMESPACE, action=Marker.DELETEALL)])
