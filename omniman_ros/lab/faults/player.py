"""Carries out and removes the injections of the table, and moves the robot meanwhile."""

import math
from collections.abc import Callable
from functools import singledispatchmethod
from signal import SIGCONT, SIGKILL, SIGSTOP
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.console.preview_messages import twist_message
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.motion_limits import LIMITED
from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.lab.faults.injections import (
    EmergencyStop,
    Garbage,
    Injection,
    Publication,
    Restart,
    Second,
    ServiceStop,
    Setting,
    Signal,
    TwistFault,
)
from omniman_ros.lab.faults.rows import Motion
from omniman_ros.lab.faults.running_robot import RunningRobot
from omniman_ros.nodes.stop_interface import LATCHED

SPEED = 0.5
"""Speed of the platform when a fault begins [m/s]."""
ARM_SPEED = 0.6
"""Speed of the first joint of the arm when a fault begins [rad/s]."""
RAMP = 1.2
"""Time in which a trajectory reaches its speed [s]."""
CRUISE = 4.0
"""Time for which a trajectory has its speed [s]."""
STEP = 0.1
"""Time between two points of a trajectory [s]."""
TWIST_PERIOD = 0.02
"""Period of `cmd_vel` [s]."""
DASHBOARD_PAUSE = 1.0
"""Time for which the arm's controller carries a command of its dashboard out [s]."""
GARBAGE_PERIOD = 0.01
"""Period of garbage [s]."""
FLOOD = 20
"""Number of twists that are sent in each period of a flood."""
JUMP = 100.0
"""Factor of a twist that jumps."""
PLATFORM_JOINTS = ("odom_x", "odom_y", "odom_t")
"""Names of the platform's coordinates in `joint_trajectory`."""
NUMBERS = {Garbage.NAN: math.nan, Garbage.INFINITE: math.inf, Garbage.HUGE: 1e300}
"""Numbers that garbage consists of."""
NEWEST = QoSProfile(depth=1)
"""Quality of service of topics of which only the last message counts."""


def cruise(ramp: float, duration: float, step: float) -> tuple[Array, Array, Array]:
    """Return a motion from rest to rest with a constant speed of 1 in between.

    The speed rises and falls by the cubic 3 u^2 - 2 u^3 of the share u of the ramp's time.

    Args:
        ramp: Time of each ramp [s].
        duration: Time at speed 1 [s].
        step: Time between two samples [s].

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


class Player:
    """Moves the robot, injects faults, and removes them.

    Args:
        robot: The running robot.

    Attributes:
        robot: The running robot.
        forwards: Direction of the next motion, 1 or -1, so that the robot stays where it is.
    """

    def __init__(self, robot: RunningRobot) -> None:
        self.robot, self.forwards = robot, 1.0
        node = robot.session.node
        self._twists = node.create_publisher(Twist, "cmd_vel", NEWEST)
        self._opposed = node.create_publisher(Twist, "cmd_vel", NEWEST)
        self._trajectories = node.create_publisher(JointTrajectory, "joint_trajectory", 10)
        self._button = node.create_publisher(Bool, "emergency_stop", LATCHED)
        self._other_button = node.create_publisher(Bool, "emergency_stop", LATCHED)
        self._odometry: Odometry | None = None
        node.create_subscription(Odometry, "odom", self._on_odometry, NEWEST)
        self._garbage = {
            topic: (node.create_publisher(kind, topic, NEWEST), make)
            for topic, (kind, make) in GARBAGE_TOPICS.items()
        }
        self._twist: Triple | None = None
        self._twist_fault: TwistFault | None = None
        self._publication: Publication | None = None
        self._releasing = False
        node.create_timer(TWIST_PERIOD, self._send_twist)
        node.create_timer(GARBAGE_PERIOD, self._send_garbage)

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry = message

    # ---- motion ---------------------------------------------------------------------------------

    def drive(self, motion: Motion) -> None:
        """Begin a motion that lasts for `RAMP` and `CRUISE`; the next one is backwards."""
        self.forwards = -self.forwards
        with_platform = motion is Motion.TRAJECTORY
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
        angles, pose = self.robot.truth.angles, self.pose
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
        twist, fault = self._twist, self._twist_fault
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

    def _send_garbage(self) -> None:
        if self._releasing:
            self._other_button.publish(Bool(data=False))
        if self._publication is not None:
            publisher, make = self._garbage[self._publication.topic]
            message = make(self._publication.content)
            message.header.stamp = self.robot.session.node.get_clock().now().to_msg()
            publisher.publish(message)

    # ---- faults ---------------------------------------------------------------------------------

    def prepare(self, injection: Injection) -> None:
        """Connect to what the injection needs, so that it comes without delay."""
        match injection:
            case Setting(node, parameter, _, cleared, _):
                self.robot.set_parameter(node, parameter, cleared)
            case ServiceStop(node):
                self.robot.connect(node, "stop")

    @singledispatchmethod
    def inject(self, injection: Injection) -> None:
        """Inject a fault."""
        raise TypeError(f"no way to inject {injection}")

    @inject.register
    def _(self, injection: Signal) -> None:
        if injection.number is SIGKILL:
            self.robot.signal(injection.process, SIGKILL)
            return
        self.robot.signal(injection.process, injection.number)
        if injection.resume is not None:
            self.robot.pause(injection.resume)
            self.robot.signal(injection.process, SIGCONT)

    @inject.register
    def _(self, injection: Restart) -> None:
        self.robot.kill(injection.process)
        self.robot.start(injection.process)

    @inject.register
    def _(self, injection: Second) -> None:
        self.robot.start(injection.process, copy=_copy_of(injection.process))

    @inject.register
    def _(self, injection: Setting) -> None:
        self.robot.set_parameter(injection.node, injection.parameter, injection.value)

    @inject.register
    def _(self, injection: TwistFault) -> None:
        self._twist_fault = injection

    @inject.register
    def _(self, injection: Publication) -> None:
        self._publication = injection

    @inject.register
    def _(self, injection: EmergencyStop) -> None:
        self._button.publish(Bool(data=True))
        self._releasing = injection.others_release

    @inject.register
    def _(self, injection: ServiceStop) -> None:
        self.robot.trigger(injection.node, "stop")

    def remove(self, injection: Injection) -> None:
        """Remove a fault; what was killed stays away until :meth:`repair`."""
        self._twist_fault = self._publication = None
        self._releasing = False
        match injection:
            case Signal(process, number, _) if number is SIGSTOP:
                self.robot.signal(process, SIGCONT)
            case Second(process):
                self.robot.kill(_copy_of(process))
            case Setting(node, parameter, _, cleared, commands):
                self.robot.set_parameter(node, parameter, cleared)
                for command in commands:
                    self.robot.send_to_dashboard(command)
                    self.robot.pause(DASHBOARD_PAUSE)
            case EmergencyStop():
                self._button.publish(Bool(data=False))

    def repair(self) -> list[str]:
        """Start every process that has ended; return their names."""
        ended = [name for name in self.robot.names if not self.robot.is_alive(name)]
        for name in ended:
            self.robot.kill(name)
            self.robot.start(name)
        return ended


def _copy_of(process: str) -> str:
    """Return the name of a second copy of a process."""
    return f"{process} (second)"


def _joint_message(names: list[str]) -> Callable[[Garbage], JointState]:
    """Return a function that makes joint states of garbage."""

    def make(content: Garbage) -> JointState:
        if content is Garbage.EMPTY:
            return JointState()
        if content is Garbage.WRONG_NAMES:
            return JointState(name=["nobody"], position=[0.0], velocity=[0.0], effort=[0.0])
        values = [NUMBERS.get(content, 0.0)] * len(names)
        return JointState(name=names, position=values, velocity=values, effort=values)

    return make


def _odometry_message(content: Garbage) -> Odometry:
    message = Odometry()
    message.header.frame_id = "nowhere" if content is Garbage.WRONG_FRAME else "odom"
    message.child_frame_id = "base_link"
    value = NUMBERS.get(content, 0.0)
    message.pose.pose.position.x = message.twist.twist.linear.x = value
    message.pose.pose.orientation.w = 1.0
    return message


def _trajectory_message(content: Garbage) -> JointTrajectory:
    values = [NUMBERS.get(content, 0.0)] * len(UR_JOINTS)
    points = [
        JointTrajectoryPoint(
            positions=values, velocities=values, time_from_start=Duration(seconds=t).to_msg()
        )
        for t in (0.0, 0.4)
    ]
    return JointTrajectory(joint_names=list(UR_JOINTS), points=points)


_WHEELS = ["front_left", "front_right", "rear_left", "rear_right"]
_wheels, _joints = _joint_message(_WHEELS), _joint_message(list(UR_JOINTS))
GARBAGE_TOPICS: dict[str, tuple[type, Callable[[Garbage], Any]]] = {
    "wheel_commands": (JointState, _wheels),
    "wheel_states": (JointState, _wheels),
    "odom": (Odometry, _odometry_message),
    "arm/joint_states": (JointState, _joints),
    "arm/joint_reference": (JointTrajectory, _trajectory_message),
    "motion_limit": (JointState, _joint_message(list(LIMITED))),
}
"""Type of each topic that garbage is sent on, and the function that makes its messages."""
