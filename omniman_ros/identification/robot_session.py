"""Drives the robot over ROS, and records its wheels and measured poses."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.console.errors import CommandError
from omniman_ros.console.preview_messages import PREVIEW_PERIOD, preview_message
from omniman_ros.console.progress import Progress
from omniman_ros.console.session import DISCOVERY_TIMEOUT, PeriodicTicks, Session
from omniman_ros.control.encoder import Unwrapper
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.joints import joint_arrays
from omniman_ros.conversions.wheels import electrical_arrays
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build, specs
from omniman_ros.core.planar import PlanarSample, Triple
from omniman_ros.identification.node_access import (
    LATCHED,
    LOSSLESS,
    RESPONSE_TIMEOUT,
    SIM_TIME,
    read_parameters,
)

ELECTRICAL = "wheel_electrical"  #: Topic of the motors' voltages and currents
CONTROLLER = "platform_controller"  #: Name of the node that drives the robot
USES_STAMPED_TWISTS = "cmd_vel_stamped"  #: Whether it subscribes to a TwistStamped
LEAD_TIME = 0.3  #: Time from the first preview to the start of a motion [s]
SETTLING_TIME = 0.8  #: Time at rest after a motion before it counts as ended [s]
AVERAGING_TIME = 0.5  #: Time over which a pose at rest is averaged [s]
AT_REST_SPEED = 0.02  #: Speed below which a wheel counts as standing [rad/s]
MAX_END_ERROR = 0.1  #: Error at the end up to which a motion was driven to its end [m, rad]
CANCELLATION_TIME = 1.5  #: Silence after which a path may follow a cancelled one [s]
SPEED_SAMPLES = 21  #: Number of positions over which the speed is differenced


class TimedMotion(Protocol):
    """A drive from rest to rest, in odom."""

    @property
    def duration(self) -> float:
        """Duration of the drive [s]."""

    def sample(self, time: float) -> PlanarSample:
        """Return the reference at a time after the start [s]."""


@dataclass(frozen=True)
class ControllerConfiguration:
    """The configuration of the platform controller."""

    parameters: PlatformParameters  #: Its parameters, those of the robot included
    is_stamped: bool  #: Whether it subscribes to a TwistStamped


def read_controller(
    session: Session, namespace: str, check: Callable[[], None]
) -> ControllerConfiguration:
    """Read the parameters of the platform controller.

    Args:
        check: Called many times a second; raises to end early.

    Raises:
        CommandError: The controller does not answer, or runs on simulated time.
    """
    name = f"/{namespace.strip('/')}/{CONTROLLER}".replace("//", "/")
    client = session.node.create_client(GetParameters, f"{name}/get_parameters")

    def is_ready() -> bool:
        check()
        return bool(client.service_is_ready())

    if not session.wait(is_ready, DISCOVERY_TIMEOUT):
        raise CommandError(
            f"no {name} within {DISCOVERY_TIMEOUT:g} s: start the robot (omniman up) or use "
            "--simulate; is ROS_DOMAIN_ID the robot's?"
        )
    names = [spec.name for spec in specs(PlatformParameters)]
    values = read_parameters(session, client, name, [*names, SIM_TIME, USES_STAMPED_TWISTS])
    if values.get(SIM_TIME):
        raise CommandError(f"{name} runs on simulated time (use_sim_time): start it without")
    return ControllerConfiguration(
        build(PlatformParameters, values), bool(values.get(USES_STAMPED_TWISTS))
    )


@dataclass
class Recording:
    """Feedback that was received since :meth:`RobotSession.start_recording`."""

    times: list[float] = field(default_factory=list)  #: Stamps of wheel_states, ROS time [s]
    #: Positions of the wheels (n,), not wrapped [rad]
    positions: list[Array] = field(default_factory=list)
    #: Stamps (ROS time) and measured poses (x, y, heading) [s, m, m, rad]
    truth: list[tuple[float, float, float, float]] = field(default_factory=list)
    #: Voltages and currents (n,) [V, A] of wheel_electrical, which has no stamp: each with the
    #: stamp of the latest wheel_states, ROS time [s]. Empty unless requested.
    electrical: list[tuple[float, Array, Array]] = field(default_factory=list)

    def differenced_speed(self) -> float:
        """Return the speed of the fastest wheel by the latest positions [rad/s]."""
        span = slice(-SPEED_SAMPLES, None)
        times, positions = self.times[span], self.positions[span]
        moved = float(np.abs(positions[-1] - positions[0]).max())
        return moved / max(times[-1] - times[0], 1e-3)


class RobotSession:
    """Drives motions and records the wheels.

    A robot that has stopped, does not follow, or is driven by others raises a CommandError, as do
    topics and nodes that are silent; a signal raises a KeyboardInterrupt.

    Args:
        truth: Topic of a measured pose, or None.
    """

    def __init__(
        self,
        session: Session,
        controller: ControllerConfiguration,
        truth: str | None,
        progress: Progress,
        poll: Callable[[], None],
        with_electrical: bool = False,
    ) -> None:
        self._session = session
        parameters = controller.parameters
        self._names = parameters.robot.wheels.names
        span = parameters.odometry.encoder_span
        self._unwrap = Unwrapper(span).update if span else np.array
        self._truth_topic = truth
        self._progress = progress
        self._poll = poll
        self._pose: Triple | None = None
        self._speed = math.inf
        self._source = ""
        self._stop_reasons: dict[str, str] = {}
        self._received: set[str] = set()
        self.recording = Recording()  #: The current recording
        node = session.node
        self._is_stamped = controller.is_stamped
        self._twists = node.create_publisher(
            TwistStamped if self._is_stamped else Twist, "cmd_vel", 1
        )
        self._previews = node.create_publisher(MultiDOFJointTrajectory, "path/reference", 1)
        node.create_subscription(JointState, "wheel_states", self._on_wheels, LOSSLESS)
        node.create_subscription(Odometry, "odom", self._on_odom, 10)
        node.create_subscription(String, "active_source", self._on_source, LATCHED)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop_state, LATCHED)
        self._with_electrical = with_electrical
        if truth is not None:
            node.create_subscription(Odometry, truth, self._on_truth, LOSSLESS)
        if with_electrical:
            node.create_subscription(Float64MultiArray, ELECTRICAL, self._on_electrical, LOSSLESS)

    # ---- topics -------------------------------------------------------------------------------

    def _on_wheels(self, message: JointState) -> None:
        position, velocity, _ = joint_arrays(message, self._names)
        if position is None:
            raise InputError("wheel_states without positions")
        plausible.demand(position, plausible.WHEEL_ANGLE, "wheel_states: positions")
        self.recording.times.append(time_seconds(message.header.stamp))
        self.recording.positions.append(self._unwrap(position))
        if velocity is not None:
            self._speed = float(np.abs(velocity).max())
        elif len(self.recording.positions) > 1:
            self._speed = self.recording.differenced_speed()
        self._received.add("wheel_states")

    def _on_odom(self, message: Odometry) -> None:
        self._pose = _pose(message)
        self._received.add("odom")

    def _on_truth(self, message: Odometry) -> None:
        stamp = time_seconds(message.header.stamp)
        self.recording.truth.append((stamp, *_pose(message)))
        assert self._truth_topic is not None
        self._received.add(self._truth_topic)

    def _on_electrical(self, message: Float64MultiArray) -> None:
        self._received.add(ELECTRICAL)
        if self.recording.times:
            voltages, currents = electrical_arrays(message, len(self._names))
            self.recording.electrical.append((self.recording.times[-1], voltages, currents))

    def _on_source(self, message: String) -> None:
        self._source = message.data

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        if message.level == DiagnosticStatus.ERROR:
            self._stop_reasons[message.name] = message.message
        else:
            self._stop_reasons.pop(message.name, None)

    # ---- waiting ------------------------------------------------------------------------------

    @property
    def pose(self) -> Triple:
        """Pose by the odometry, in odom [m, m, rad]; the heading is wrapped."""
        assert self._pose is not None
        return self._pose

    def wait(self) -> None:
        """Serve ROS for a moment."""
        self._session.spin(0.05)
        self._check()

    def _check(self) -> None:
        self._poll()
        for name, reason in self._stop_reasons.items():
            raise CommandError(f"the robot stopped: {name} is {reason}")

    def _wait_until(self, condition: Callable[[], bool], timeout: float) -> bool:
        def checked() -> bool:
            self._check()
            return condition()

        return self._session.wait(checked, timeout)

    def connect(self) -> None:
        """Wait until all topics that are needed arrive, and nobody drives the robot."""
        needed = ["odom", "wheel_states", *([self._truth_topic] if self._truth_topic else [])]
        needed += [ELECTRICAL] if self._with_electrical else []

        def missing() -> list[str]:
            names = [f"'{topic}'" for topic in needed if topic not in self._received]
            if not self._previews.get_subscription_count():
                names.append("a subscriber of 'path/reference'")
            return names

        if not self._wait_until(lambda: not missing(), DISCOVERY_TIMEOUT):
            raise CommandError(f"missing after {DISCOVERY_TIMEOUT:g} s: {', '.join(missing())}")
        if not self._wait_until(lambda: self._source == "none", RESPONSE_TIMEOUT):
            raise CommandError(f"'{self._source}' drives the robot: end that first")

    # ---- driving ------------------------------------------------------------------------------

    def start_recording(self) -> None:
        """Begin a new recording, with the current wheel positions as its first."""
        self.recording = Recording()
        if not self._wait_until(lambda: bool(self.recording.positions), RESPONSE_TIMEOUT):
            raise CommandError(f"no wheel_states for {RESPONSE_TIMEOUT:g} s")

    def drive(
        self,
        name: str,
        motion: TimedMotion,
        progress_range: tuple[float, float] = (0.0, 1.0),
        reach: float = math.inf,
    ) -> bool:
        """Drive a motion and wait for rest.

        Args:
            name: Name of the run that it belongs to, for messages.
            motion: Motion in odom.
            progress_range: Progress of the run at the motion's start and end.
            reach: Distance from the motion's start, along x and along y of its frame, at which the
                drive is given up [m].

        Returns:
            Whether the robot arrived at the end; if not, the path was cancelled on the way.
        """
        clock = self._session.node.get_clock()
        start = clock.now() + Duration(nanoseconds=round(LEAD_TIME * 1e9))
        has_driven = False
        duration = LEAD_TIME + motion.duration + SETTLING_TIME
        first, last = progress_range
        origin = motion.sample(0.0).pose

        def check() -> None:
            self._check()
            away = distance_along(origin, self.pose)
            if away > reach:
                raise CommandError(
                    f"run '{name}': the robot is {away:.2f} m from its start along a side of the "
                    f"square, {reach:.2f} m is allowed: does it follow?"
                )

        for elapsed in PeriodicTicks(self._session, duration, PREVIEW_PERIOD, check):
            if elapsed < LEAD_TIME + motion.duration:
                self._previews.publish(preview_message(motion, clock.now(), start))
            has_driven |= self._source == "path"
            self._progress.update(first + (last - first) * elapsed / duration, "")
        if not has_driven:
            raise CommandError(f"run '{name}': '{self._source}' drives, not this path")
        if not self._wait_until(self._is_at_rest, RESPONSE_TIMEOUT):
            raise CommandError(f"run '{name}': the robot does not come to rest")
        end, (x, y, theta) = motion.sample(motion.duration).pose, self.pose
        error = max(
            math.hypot(x - end[0], y - end[1]), abs(math.remainder(theta - end[2], math.tau))
        )
        if error <= MAX_END_ERROR:
            return True
        self._wait_until(lambda: False, CANCELLATION_TIME)
        return False

    def _is_at_rest(self) -> bool:
        return self._source == "none" and self._speed < AT_REST_SPEED

    def halt(self) -> None:
        """Bring the robot to rest with a zero twist, which takes precedence over any path."""
        for _ in range(3):
            message = TwistStamped() if self._is_stamped else Twist()
            if self._is_stamped:
                message.header.stamp = self._session.node.get_clock().now().to_msg()
                message.header.frame_id = "base_link"
            self._twists.publish(message)
        self._twists.wait_for_all_acked(Duration(seconds=1))

    def pose_at_rest(self) -> Triple | None:
        """Return the mean measured pose over `AVERAGING_TIME` in the topic's frame, or None."""
        before = len(self.recording.truth)
        self._wait_until(lambda: False, AVERAGING_TIME)
        rows = np.array(self.recording.truth[before:])
        if not len(rows):
            return None
        angle = math.atan2(np.sin(rows[:, 3]).mean(), np.cos(rows[:, 3]).mean())
        return float(rows[:, 1].mean()), float(rows[:, 2].mean()), angle


def distance_along(origin: Triple, pose: Triple) -> float:
    """Return the larger distance of a pose from an origin along x and along y of its frame [m]."""
    dx, dy = pose[0] - origin[0], pose[1] - origin[1]
    c, s = math.cos(origin[2]), math.sin(origin[2])
    return max(abs(c * dx + s * dy), abs(c * dy - s * dx))


def _pose(message: Odometry) -> Triple:
    position = message.pose.pose.position
    plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "measured position")
    return position.x, position.y, yaw_from_quaternion(message.pose.pose.orientation)
