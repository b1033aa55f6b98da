"""Moves the running robot: a stream of twists, which may be at fault, and trajectories."""

import math

import numpy as np
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.console.preview_messages import twist_message
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.lab.faults.ground_truth import GroundTruth
from omniman_ros.lab.faults.injections import TwistFault
from omniman_ros.lab.faults.rows import MotionKind

SPEED = 0.5  #: speed of the platform when a fault begins [m/s]
ARM_SPEED = 0.6  #: speed of the first joint of the arm when a fault begins [rad/s]
RAMP = 1.2  #: time in which a trajectory reaches its speed [s]
CRUISE = 4.0  #: time for which a trajectory has its speed [s]
STEP = 0.1  #: time between two points of a trajectory [s]
TWIST_PERIOD = 0.02  #: period of `cmd_vel` [s]
FLOOD = 20  #: number of twists that are sent in each period of a flood
JUMP = 100.0  #: factor of a twist that jumps
#: Names of the platform's coordinates in `joint_trajectory`
PLATFORM_JOINTS = ("odom_x", "odom_y", "odom_t")
NEWEST = QoSProfile(depth=1)  #: quality of service of topics of which only the last message counts


def cruise(ramp: float, duration: float, step: float) -> tuple[Array, Array, Array]:
    """Return a motion from rest to rest with a constant speed of 1 in between.

    The speed rises and falls by the cubic 3 u^2 - 2 u^3 of the share u of the ramp's time.

    Returns:
        Times (m,) [s], ways (m,) [s] and speeds (m,); the last sample is at rest.
    """
    total = 2.0 * ramp + duration
    times = np.append(np.arange(0.0, total - 1e-9, step), total)

    def way(t: Array) -> Array:
        u = np.clip(t / ramp, 0.0, 1.0)
        result: Array = ramp * (u**3 - 0.5 * u**4) + np.maximum(t - ramp, 0.0)
        return result

    # The end is the beginning backwards: the way is symmetric about the middle.
    whole = 2.0 * way(np.array([0.5 * total]))[0]
    early = times <= 0.5 * total
    ways = np.where(early, way(times), whole - way(total - times))
    u = np.clip(np.minimum(times, total - times) / ramp, 0.0, 1.0)
    return times, ways, 3.0 * u**2 - 2.0 * u**3


class Driver:
    """Moves platform and arm."""

    def __init__(self, node: Node, truth: GroundTruth) -> None:
        self._truth, self.forwards = truth, 1.0
        self._twists = node.create_publisher(Twist, "cmd_vel", NEWEST)
        self._opposed = node.create_publisher(Twist, "cmd_vel", NEWEST)
        self._trajectories = node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        self._odometry: Odometry | None = None
        node.create_subscription(Odometry, "odom", self._on_odometry, NEWEST)
        self._twist: Triple | None = None
        self.fault: TwistFault | None = None
        node.create_timer(TWIST_PERIOD, self._send_twist)

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry = message

    def begin_motion(self, motion: MotionKind) -> None:
        """Begin a motion that lasts for `RAMP` and `CRUISE`; the next one is backwards."""
        self.forwards = -self.forwards
        with_platform = motion is MotionKind.TRAJECTORY
        self._twist = None if with_platform else (self.forwards * SPEED, 0.0, 0.0)
        self._send_trajectory(with_platform)

    def halt(self) -> None:
        """End the stream of twists with a zero twist."""
        if self._twist is not None:
            self._twists.publish(twist_message((0.0, 0.0, 0.0)))
        self._twist = None

    def begin_twist(self, twist: Triple) -> None:
        """Send a twist x', y' [m/s], theta' [rad/s] until :meth:`halt`."""
        self._twist = twist

    @property
    def pose(self) -> Array | None:
        """Pose x, y, theta (3,) by odometry [m, m, rad]; None before the first."""
        if self._odometry is None:
            return None
        pose = self._odometry.pose.pose
        yaw = yaw_from_quaternion(pose.orientation)
        return np.array([pose.position.x, pose.position.y, yaw])

    def _send_trajectory(self, with_platform: bool) -> None:
        angles, pose = self._truth.angles, self.pose
        if angles is None or pose is None:
            return
        times, ways, speeds = cruise(RAMP, CRUISE, STEP)
        names, start, rates = list(UR_JOINTS), angles, np.zeros(len(angles))
        rates[0] = -math.copysign(ARM_SPEED, angles[0])  # back and forth about zero
        if with_platform:
            names, start = [*PLATFORM_JOINTS, *names], np.append(pose, angles)
            speed, yaw = self.forwards * SPEED, float(pose[2])
            rates = np.array([speed * math.cos(yaw), speed * math.sin(yaw), 0.0, *rates])
        points = [
            JointTrajectoryPoint(
                positions=(start + way * rates).tolist(),
                velocities=(speed * rates).tolist(),
                time_from_start=Duration(seconds=t).to_msg(),
            )
            for t, way, speed in zip(times.tolist(), ways, speeds, strict=True)
        ]
        self._trajectories.publish(JointTrajectory(joint_names=names, points=points))

    def _send_twist(self) -> None:
        twist, fault = self._twist, self.fault
        if twist is None or fault is TwistFault.SILENT:
            return
        x, y, yaw_rate = twist
        opposed = (-x, -y, -yaw_rate)
        if fault in (TwistFault.NAN, TwistFault.INFINITE):
            twist = (math.nan if fault is TwistFault.NAN else math.inf, y, yaw_rate)
        elif fault is TwistFault.JUMP:
            twist = (JUMP * x, JUMP * y, JUMP * yaw_rate)
        for _ in range(FLOOD if fault is TwistFault.FLOOD else 1):
            self._twists.publish(twist_message(twist))
        if fault is TwistFault.OPPOSED:
            self._opposed.publish(twist_message(opposed))
