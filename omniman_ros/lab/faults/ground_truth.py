"""Where the simulated robot really is."""

import time

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from omniman_ros.console.session import Session
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core.arrays import Array
from omniman_ros.nodes.rclpy_compat import subscribe_with_source_time

YAW_ARM = 0.5  #: distance from its centre at which a turn of the platform counts as speed [m]

ALL = QoSProfile(depth=1000)  #: quality of service of reports of which none may be lost


class GroundTruth:
    """Records where the simulated robot really is.

    Speeds are those of the platform, where a turn counts by `YAW_ARM`, and of the fastest joint.
    Samples count at their stamps, the instants up to which drives and arm were simulated, whenever
    they were sent and received. In simulated time nothing is held up, as time waits.
    """

    def __init__(self, session: Session) -> None:
        self._platform: list[tuple[float, ...]] = []
        self._arm: list[tuple[float, ...]] = []
        self._is_simulated, self._longest_lag = session.is_simulated, 0.0
        #: How long ago the last report was sent when it was received [s]; 0 in simulated time
        self.age = 0.0
        node = session.node
        subscribe_with_source_time(node, Odometry, "ground_truth/odom", self._on_odom, ALL)
        subscribe_with_source_time(
            node, JointState, "ground_truth/arm_joint_states", self._on_joints, ALL
        )

    def _on_odom(self, message: Odometry, sent: int) -> None:
        twist, position = message.twist.twist, message.pose.pose.position
        speed = np.hypot(twist.linear.x, twist.linear.y) + YAW_ARM * abs(twist.angular.z)
        at = time_seconds(message.header.stamp)
        yaw = yaw_from_quaternion(message.pose.pose.orientation)
        self._platform.append((at, float(speed), position.x, position.y, yaw))
        self._note_lag(at, sent)

    def _on_joints(self, message: JointState, sent: int) -> None:
        speed, at = max(map(abs, message.velocity)), time_seconds(message.header.stamp)
        self._arm.append((at, speed, *message.position))
        self._note_lag(at, sent)

    def _note_lag(self, at: float, sent: int) -> None:
        if not self._is_simulated:  # the middleware knows real time only
            self._longest_lag = max(self._longest_lag, sent * 1e-9 - at)
            self.age = time.time() - sent * 1e-9

    def clear(self) -> None:
        """Forget what was recorded, but for the last report."""
        del self._platform[:-1]
        del self._arm[:-1]
        self._longest_lag = 0.0

    def forget(self) -> None:
        """Forget everything, as simulated time begins anew."""
        self.clear()
        self._platform.clear()
        self._arm.clear()

    def covers(self, until: float, arm: bool) -> bool:
        """Return whether everything up to a time [s] is known, of the arm only if it counts."""
        samples = (self._platform, self._arm) if arm else (self._platform,)
        return all(bool(each) and each[-1][0] >= until for each in samples)

    @property
    def platform(self) -> Array:
        """Times [s], speeds [m/s] and poses x, y [m], theta [rad] of the platform, (m, 5)."""
        return np.array(self._platform).reshape(-1, 5)

    @property
    def arm(self) -> Array:
        """Times [s], speeds [rad/s] and angles [rad] of the arm, (m, 8)."""
        return np.array(self._arm).reshape(-1, 8)

    @property
    def longest_hold_up(self) -> float:
        """Longest time for which the machine held drives or arm up [s].

        They leave a gap between two reports, or are simulated later than reports are sent.
        """
        gaps = [np.diff(samples[:, 0]).max(initial=0.0) for samples in (self.platform, self.arm)]
        return float(max(*gaps, self._longest_lag))

    @property
    def speeds(self) -> tuple[float, float]:
        """Last speeds of platform [m/s] and arm [rad/s]; 0 before the first."""
        platform = self._platform[-1][1] if self._platform else 0.0
        return platform, self._arm[-1][1] if self._arm else 0.0

    @property
    def pose(self) -> Array | None:
        """Last pose x, y, theta (3,) of the platform [m, m, rad]; None before the first."""
        return np.array(self._platform[-1][2:]) if self._platform else None

    @property
    def angles(self) -> Array | None:
        """Last angles of the arm (6,) [rad]; None before the first."""
        return np.array(self._arm[-1][2:]) if self._arm else None
