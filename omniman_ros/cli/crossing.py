"""Obstacles of the demo: some cross the robot's way, one stands; and how near it came to them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from numpy.typing import NDArray
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.core import se2
from omniman_ros.planning.separation import box_gap

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

HEIGHT = 1.0
"""Of the cylinders [m]."""
NAMESPACE = "demo"
SHOWN = ((1.3, -1.9, 0.0, 0.45, 0.3), (2.2, 2.0, 0.0, -0.4, 0.3), (1.9, -0.95, 0.0, 0.0, 0.25))
"""Place [m], velocity [m/s] and radius [m] of each, as the robot sees them at the start."""
GOAL = (3.2, 0.3, 1.5707963)
"""Behind them, as the robot sees it at the start [m, m, rad]."""


@dataclass(frozen=True)
class Crossing:
    """Cylinders on straight ways in odom.

    Attributes:
        begin: ROS time at which they are at `places` [s].
        places: (M, 2) [m].
        velocities: (M, 2) [m/s].
        radii: (M,) [m].
    """

    begin: float
    places: Array
    velocities: Array
    radii: Array

    @staticmethod
    def before(robot: Triple, begin: float) -> "Crossing":
        """The obstacles of the demo, before a robot at a pose in odom [m, m, rad]."""
        table = np.array(SHOWN)
        turn = se2.rotation(robot[2])[:2, :2]
        places = table[:, :2] @ turn + np.array(robot[:2])
        return Crossing(begin, places, table[:, 2:4] @ turn, table[:, 4])

    def at(self, time: float) -> Array:
        """Where they are (M, 2) at a ROS time [s]."""
        result: Array = self.places + (time - self.begin) * self.velocities
        return result

    def message(self, time: float, stamp: Time, frame: str = "odom") -> MarkerArray:
        """What a sensor would say of them."""
        header = Header(stamp=stamp, frame_id=frame)
        return MarkerArray(
            markers=[
                Marker(
                    header=header, ns=NAMESPACE, id=k, type=Marker.CYLINDER, action=Marker.ADD,
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
        )  # fmt: skip

    def gone(self) -> MarkerArray:
        """What a sensor says when they have left."""
        return MarkerArray(markers=[Marker(ns=NAMESPACE, action=Marker.DELETEALL)])

    def gaps(self, rows: Array, half: Sequence[float]) -> Array:
        """Gap (K, M) [m] to the robot's box; rows (K, 4): ROS time, x, y, theta in odom."""
        centers = np.array([self.at(time) for time in rows[:, 0].tolist()])
        axes = np.broadcast_to(self.radii[:, None], (len(rows), len(self.radii), 2))
        return box_gap(rows[:, 1:4], np.array(half), centers, axes, np.zeros(len(self.radii)))
