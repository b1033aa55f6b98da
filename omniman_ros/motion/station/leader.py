"""Motion of a leader, predicted from its odometry, and of a station that is fixed to it."""

import math
from dataclasses import dataclass

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple


@dataclass(frozen=True)
class Leader:
    """The leader at the time of a measurement; its twist is taken to be constant from then on."""

    time: float  #: Time of the measurement [s]
    pose: Triple  #: Pose of its base_link in odom of the follower [m, m, rad]
    twist: Array  #: Twist (3,) in its base_link [m/s, m/s, rad/s]

    def predicted_pose(self, time: float) -> Triple:
        """Return the pose at a time [s], in odom of the follower [m, m, rad]."""
        return se2.compose(self.pose, se2.arc(self.twist * (time - self.time)))

    def station(self, offset: Triple, time: float) -> tuple[Triple, Triple]:
        """Return pose and velocity of a station at a time, in odom of the follower.

        A station at (a, b) in base_link of the leader, whose twist is (x', y', theta'), moves
        at (x' - theta' b, y' + theta' a, theta') there.

        Returns:
            Pose [m, m, rad], whose heading is not wrapped, and velocity [m/s, m/s, rad/s].
        """
        pose = self.predicted_pose(time)
        x_rate, y_rate, yaw_rate = self.twist.tolist()
        ux, uy = x_rate - yaw_rate * offset[1], y_rate + yaw_rate * offset[0]
        c, s = math.cos(pose[2]), math.sin(pose[2])
        return se2.compose(pose, offset), (c * ux - s * uy, s * ux + c * uy, yaw_rate)
