"""What is measured of the robot, as a node receives it, and previews of its motion."""

import functools
import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory

from omniman_ros.conversions import arm as arm_conversions
from omniman_ros.conversions.geometry import twist_array, yaw_from_quaternion
from omniman_ros.conversions.headers import check_frame
from omniman_ros.conversions.trajectories import fill_reference, reference_message
from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import MAX_POINTS
from omniman_ros.core.stamps import MAX_LEAD
from omniman_ros.motion.path.joint_parameters import ArmFollowing
from omniman_ros.motion.path.pace import Window
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.nodes.arm_states import ArmStates, ArmStatesReader
from omniman_ros.nodes.omniman_node import OmnimanNode

#: Speed of the platform [m/s, rad/s] and of joints [rad/s] up to which they are at rest
AT_REST = 0.02
MAX_LAG = 0.2  #: Longest time by which the arm may lag behind its reference [s]


class _Feed:
    """Measurements of a part of the robot, and how old they are.

    Attributes:
        time: Time of the last usable measurement on the node's clock [s].
        silence: Age of the measurement on arrival plus the node's own time since then [s].
    """

    def __init__(self, node: OmnimanNode) -> None:
        self._node = node
        self.time, self.silence = float("-inf"), 0.0

    @property
    def age(self) -> float:
        """Age of the measurement [s]; infinite without one, and after time went back behind it."""
        age = self._node.now() - self.time
        return age if age >= -MAX_LEAD else math.inf

    def pass_time(self, elapsed: float) -> None:
        """Advance the silence by the node's own time [s].

        Time during which the node itself is held up must not be counted in full, because the robot
        is not silent then.
        """
        self.silence += elapsed

    def forget(self) -> None:
        """Treat the last measurement as too old, because time went back."""
        self.time = float("-inf")


class OdomFeed(_Feed):
    """Subscribes to an odometry, and keeps the latest pose and velocity.

    Attributes:
        pose: Pose (x, y, theta) of base_link in odom [m, m, rad]; None before the first message.
        twist: (3,) velocity in the robot's frame [m/s, m/s, rad/s].
        velocity: (3,) rate of the pose, in odom [m/s, m/s, rad/s].
    """

    def __init__(
        self,
        node: OmnimanNode,
        topic: str,
        frame: str,
        on_pose: Callable[[Array, float], None] = lambda pose, at: None,
    ) -> None:
        super().__init__(node)
        self._frame, self._on_pose = frame, on_pose
        self.pose: tuple[float, float, float] | None = None
        self.twist: Array = np.zeros(3)
        self.velocity: Array = np.zeros(3)
        node.create_subscription(Odometry, topic, node.guarded(topic, self._on_odom), 1)

    def _on_odom(self, message: Odometry) -> None:
        check_frame(message.header.frame_id, self._frame)
        twist, place = twist_array(message.twist.twist), message.pose.pose
        position, theta = place.position, yaw_from_quaternion(place.orientation)
        plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
        instant, now = self._node.instant(message.header.stamp), self._node.now()
        self.time = min(instant, now)
        self.silence = now - self.time
        self.pose = (position.x, position.y, theta)
        self.twist, self.velocity = twist, se2.to_world(theta, twist)
        self._on_pose(np.array(self.pose), self.time)

    def blocking_reason(self, timeout: float) -> str:
        """Return why no motion can start from rest; odom older than `timeout` [s] is a reason."""
        age = self.age
        if self.pose is None:
            return "no odom"
        if age > timeout:
            return f"odom is {age:.2f} s old"
        return "the robot moves" if np.abs(self.velocity).max() > AT_REST else ""


class ArmFeed(_Feed):
    """Subscribes to `arm/joint_states`, and remembers the recent reference of the arm.

    Args:
        on_message: Called with each message, which is read when it is asked for.

    Attributes:
        position: (6,) joint angles [rad]; None before the first usable message.
        velocity: (6,) joint rates [rad/s]; zeros if they are not reported.
        rest_position: (6,) joint angles at which the last motion came to rest [rad]; None if it
            was given up, or there was none.
    """

    def __init__(
        self,
        node: OmnimanNode,
        names: tuple[str, ...],
        on_message: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(node)
        self._names = names
        self.position: Array | None = None
        self.velocity: Array = np.zeros(len(names))
        self.rest_position: Array | None = None
        self._references: deque[tuple[float, Array]] = deque()
        self._reader = ArmStatesReader(node, names, on_message)

    def measure(self) -> None:
        """Read the last message, unless that was done; raise InputError if it is unusable."""
        self._adopt(self._reader.read())

    def _adopt(self, states: ArmStates | None) -> None:
        """Use states that have just been read, if there are any."""
        if states is not None:
            self.position, self.velocity = states.position, states.velocity
            self.time = states.time
            self.silence = max(self.age, 0.0)

    def state(self) -> tuple[Array, Array] | None:
        """Return the last usable joint angles [rad] and rates [rad/s], (6,) each, if any."""
        self._adopt(self._reader.poll())
        return None if self.position is None else (self.position, self.velocity)

    def start_motion(self) -> None:
        """Note that a motion starts from rest."""
        self.silence = 0.0
        self._references.clear()

    def record_reference(self, position: Array) -> None:
        """Record the present reference (6,) of the arm [rad]."""
        now = self._node.now()
        self._references.append((now, position))
        while self._references[0][0] < now - MAX_LAG - 2.0 * TICK:
            self._references.popleft()

    def following_error(self, max_error: float) -> str:
        """Return which joint is over `max_error` [rad] from its reference of the last 0.2 s."""
        if self.position is None or not self._references:
            return ""
        recent = np.array([reference for _, reference in self._references])
        error = np.maximum(self.position - recent.max(axis=0), recent.min(axis=0) - self.position)
        k = int(error.argmax())
        if error[k] <= max_error:
            return ""
        return f"{self._names[k]} is {error[k]:.3f} rad from its reference"

    def start_position(self, tolerance: float) -> Array | None:
        """Return the joint angles (6,) at which a motion from rest starts [rad], or None.

        They are exactly those at which the last motion came to rest, within the tolerance [rad].
        """
        rest, measured = self.rest_position, self.position
        if rest is None or measured is None:
            return measured
        return rest if np.abs(rest - measured).max() <= tolerance else measured

    def blocking_reason(self, options: ArmFollowing, *, idle: bool) -> str:
        """Return why no motion of the arm can start, or an empty string.

        It is such a reason that the last message cannot be used.
        """
        try:
            self.measure()
        except InputError as error:
            return f"arm/joint_states: {error}"
        if self.position is None:
            return "no arm/joint_states"
        age = max(self.age, self.silence) if idle else self.silence
        if age > options.states_timeout:
            return f"arm/joint_states are {age:.2f} s old"
        if not idle or self.start_position(options.start_tolerance) is self.rest_position:
            return ""
        return "" if float(np.abs(self.velocity).max()) <= AT_REST else "the arm moves"

    def forget(self) -> None:
        """Forget all measurements, because time went back."""
        super().forget()
        self._reader.forget()
        self.position = None


class Previews:
    """Publishes stretches of a stream on a topic.

    Args:
        make: Returns an empty message for a number of points and their spacing [s].
        fill: Writes a stretch into a message; its first point is due at the stamp.

    Attributes:
        covered_until: Time up to which receivers have a reference [s].
    """

    def __init__(
        self,
        node: OmnimanNode,
        publisher: Publisher,
        make: Callable[[int, float], Any],
        fill: Callable[[Any, Time, Window], None],
        horizon: float,
    ) -> None:
        self._node, self._make, self._fill = node, make, fill
        self.covered_until, self.publisher = float("inf"), publisher
        self._message, self._step = make(int(horizon / TICK) + 1, TICK), TICK

    def send(self, window: Window) -> None:
        """Publish a stretch of the stream, whose spacing may be longer than a tick."""
        message = self._message
        points = min(len(window.times), MAX_POINTS)
        step = float(window.times[1] - window.times[0])
        if points != len(message.points) or not math.isclose(step, self._step, rel_tol=1e-3):
            message, self._step = self._make(points, step), step
            self._message = message
        self._fill(message, self._node.stamp(window.times[0]), window)
        self.publisher.publish(message)
        self.covered_until = float(window.times[points - 1])


def platform_previews(node: OmnimanNode, topic: str, frame: str, horizon: float) -> Previews:
    """Create the output of the platform's previews on a topic, with poses in `frame`."""
    publisher = node.create_publisher(MultiDOFJointTrajectory, topic, QoSProfile(depth=1))
    make = functools.partial(reference_message, frame)
    return Previews(node, publisher, make, fill_reference, horizon)


def arm_previews(node: OmnimanNode, names: tuple[str, ...], horizon: float) -> Previews:
    """Create the output `arm/joint_reference`, with angles of the named joints."""
    publisher = node.create_publisher(JointTrajectory, "arm/joint_reference", QoSProfile(depth=1))
    make = functools.partial(arm_conversions.joint_reference_message, names)
    return Previews(node, publisher, make, arm_conversions.fill_joint_reference, horizon)
