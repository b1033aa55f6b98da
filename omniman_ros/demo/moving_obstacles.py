"""Obstacles on straight lines, such as those that cross the robot's path in the demo."""

import numpy as np

from omniman_ros.client.robot import Robot
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple

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

    def show_to(self, robot: Robot, time: float) -> None:
        """Tell a robot of the obstacles, where they are now, at a ROS time [s]."""
        rows = zip(self.at(time).tolist(), self.radii.tolist(), self._velocities, strict=True)
        for k, ((x, y), radius, velocity) in enumerate(rows):
            robot.add_obstacle(f"demo {k}", x, y, radius, velocity)

    def hide_from(self, robot: Robot) -> None:
        """Remove the obstacles of which a robot was told."""
        for k in range(len(self.radii)):
            robot.remove_obstacle(f"demo {k}")
