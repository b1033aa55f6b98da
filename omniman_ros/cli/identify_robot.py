"""The robot that is identified, as its public topics and services show it."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rclpy.duration import Duration
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.cli.errors import CommandError
from omniman_ros.cli.figures import Triple
from omniman_ros.cli.identify_plan import Motion
from omniman_ros.cli.previews import PREVIEW_PERIOD, preview_message
from omniman_ros.cli.progress import Progress
from omniman_ros.cli.session import DISCOVERY, Session
from omniman_ros.cli.show import Ticks
from omniman_ros.conversions import joint_arrays, time_seconds, yaw
from omniman_ros.core import plausible
from omniman_ros.core.encoder import Unwrapper
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build, specs
from omniman_ros.core.platform_parameters import PlatformParameters

Array = NDArray[np.float64]

CONTROLLER = "platform_controller"
SIM_TIME, STAMPED = "use_sim_time", "cmd_vel_stamped"
LATCHED = QoSProfile(depth=50, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ALL_OF_THEM = QoSProfile(depth=400)
"""Two seconds of wheel_states: none is lost while this process waits for its turn."""
LEAD = 0.3
"""Time from the first preview to the start of a motion [s]."""
SETTLING = 0.8
"""Time at rest after a motion before it counts as ended [s]."""
LOOK = 0.5
"""Time over which a pose at rest is averaged [s]."""
STILL = 0.02
"""Wheel speed below which it rests [rad/s]."""
OFF = 0.1
"""Distance from the reference at the end of a motion that is no tracking error [m, rad]."""
FORGIVEN = 1.5
"""Silence after which a path that was cancelled may go on: longer than timeouts.cancelled [s]."""
ANSWER = 5.0
"""How long the controller may take to tell its parameters [s]."""


@dataclass(frozen=True)
class Controller:
    """What the platform controller runs with.

    Attributes:
        parameters: Its parameters, the robot's included.
        stamped: Whether it hears a TwistStamped.
    """

    parameters: PlatformParameters
    stamped: bool


def read_controller(session: Session, namespace: str, check: Callable[[], None]) -> Controller:
    """Ask the platform controller for its parameters.

    Raises:
        CommandError: It does not answer, or runs on simulated time.
    """
    name = f"/{namespace.strip('/')}/{CONTROLLER}".replace("//", "/")
    client = session.node.create_client(GetParameters, f"{name}/get_parameters")

    def ready() -> bool:
        check()
        return bool(client.service_is_ready())

    if not session.wait(ready, DISCOVERY):
        raise CommandError(
            f"no {name} within {DISCOVERY:g} s: start the robot (omniman up) or use --simulate; "
            "is ROS_DOMAIN_ID the robot's?"
        )
    values = parameter_values(
        session,
        client,
        name,
        [spec.name for spec in specs(PlatformParameters)] + [SIM_TIME, STAMPED],
    )
    if values.get(SIM_TIME):
        raise CommandError(f"{name} runs on simulated time (use_sim_time): start it without")
    return Controller(build(PlatformParameters, values), bool(values.get(STAMPED)))


def parameter_values(
    session: Session, client: Any, name: str, asked: Sequence[str]
) -> dict[str, Any]:
    """Ask a node for parameters; what it does not have is absent.

    Args:
        session: The ROS node.
        client: Of the service `get_parameters`, ready.
        name: Of the node, for messages.
        asked: Full names of parameters.

    Raises:
        CommandError: It does not answer.
    """
    # One name a request: a single one that has no value would leave the answer to all empty.
    values = {}
    for one in asked:
        future = client.call_async(GetParameters.Request(names=[one]))
        if not session.wait(future.done, ANSWER):
            raise CommandError(f"{name} does not tell '{one}' within {ANSWER:g} s")
        for answer in future.result().values:
            if answer.type != ParameterType.PARAMETER_NOT_SET:
                values[one] = parameter_value_to_python(answer)
    return values


@dataclass
class Recording:
    """What was heard since `Robot.record`; times are ROS time [s].

    Attributes:
        times, positions: Stamps of wheel_states and positions of the wheels [rad].
        truth: Stamp, x, y, heading of the measured pose [m, m, rad].
    """

    times: list[float] = field(default_factory=list)
    positions: list[Array] = field(default_factory=list)
    truth: list[tuple[float, float, float, float]] = field(default_factory=list)


class Robot:
    """Drives motions and records the wheels.

    Args:
        session: The ROS node.
        controller: What it is set by.
        truth: Topic of a measured pose, or None.
        progress: Where progress is shown.
        poll: Called many times a second; raises to end early.
    """

    def __init__(
        self, session: Session, controller: Controller, truth: str | None,
        progress: Progress, poll: Callable[[], None],
    ) -> None:  # fmt: skip
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
        self._stopped: dict[str, str] = {}
        self._heard_at: dict[str, float] = {}
        self.recording = Recording()
        node = session.node
        self._stamped = controller.stamped
        self._twists = node.create_publisher(
            TwistStamped if self._stamped else Twist, "cmd_vel", 1
        )
        self._previews = node.create_publisher(MultiDOFJointTrajectory, "path/reference", 1)
        node.create_subscription(JointState, "wheel_states", self._on_wheels, ALL_OF_THEM)
        node.create_subscription(Odometry, "odom", self._on_odom, 10)
        node.create_subscription(String, "active_source", self._on_source, LATCHED)
        node.create_subscription(DiagnosticStatus, "stop_state", self._on_stop_state, LATCHED)
        if truth is not None:
            node.create_subscription(Odometry, truth, self._on_truth, ALL_OF_THEM)

    # ---- what is heard ------------------------------------------------------------------------

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
            self._speed = self._differenced()
        self._heard_at["wheel_states"] = time.monotonic()

    def _differenced(self) -> float:
        """Speed of the fastest wheel by its last positions [rad/s]."""
        span = slice(-21, None)
        times, positions = self.recording.times[span], self.recording.positions[span]
        moved = float(np.abs(positions[-1] - positions[0]).max())
        return moved / max(times[-1] - times[0], 1e-3)

    def _on_odom(self, message: Odometry) -> None:
        self._pose = _pose(message)
        self._heard_at["odom"] = time.monotonic()

    def _on_truth(self, message: Odometry) -> None:
        stamp = time_seconds(message.header.stamp)
        self.recording.truth.append((stamp, *_pose(message)))
        assert self._truth_topic is not None
        self._heard_at[self._truth_topic] = time.monotonic()

    def _on_source(self, message: String) -> None:
        self._source = message.data

    def _on_stop_state(self, message: DiagnosticStatus) -> None:
        if message.level == DiagnosticStatus.ERROR:
            self._stopped[message.name] = message.message
        else:
            self._stopped.pop(message.name, None)

    # ---- what is done -------------------------------------------------------------------------

    @property
    def pose(self) -> Triple:
        """Pose by odometry, in odom [m, m, rad]; the heading is wrapped."""
        assert self._pose is not None
        return self._pose

    def wait(self) -> None:
        """Serve ROS for a moment.

        Raises:
            CommandError: The robot has stopped, or a node has died.
            KeyboardInterrupt: A signal came.
        """
        self._session.spin(0.05)
        self._check()

    def _check(self) -> None:
        self._poll()
        for name, why in self._stopped.items():
            raise CommandError(f"the robot stopped: {name} is {why}")

    def meet(self) -> None:
        """Wait until all that is needed is heard, and nobody drives.

        Raises:
            CommandError: It is not in time.
        """
        needed = ["odom", "wheel_states", *([self._truth_topic] if self._truth_topic else [])]

        def absent() -> list[str]:
            lacking = [f"'{topic}'" for topic in needed if topic not in self._heard_at]
            if not self._previews.get_subscription_count():
                lacking.append("a listener to 'path/reference'")
            return lacking

        if not self._until(lambda: not absent(), DISCOVERY):
            raise CommandError(f"nothing heard within {DISCOVERY:g} s of {', '.join(absent())}")
        if not self._until(lambda: self._source == "none", ANSWER):
            raise CommandError(f"'{self._source}' drives the robot: end that first")

    def record(self) -> None:
        """Begin a new recording, with the wheels as they are now.

        Raises:
            CommandError: No wheel_states come.
        """
        self.recording = Recording()
        if not self._until(lambda: bool(self.recording.positions), ANSWER):
            raise CommandError(f"no wheel_states for {ANSWER:g} s")

    def drive(self, name: str, motion: Motion, part: tuple[float, float] = (0.0, 1.0)) -> bool:
        """Drive a motion and wait for rest.

        Args:
            name: Of what it belongs to, for messages.
            motion: In odom.
            part: Which part of it that is, for the progress.

        Returns:
            Whether it ended where it should; if not, the path was cancelled on the way.

        Raises:
            CommandError: Another source drives, or the robot does not come to rest.
        """
        clock = self._session.node.get_clock()
        start = clock.now() + Duration(nanoseconds=round(LEAD * 1e9))
        took_over = False
        whole = LEAD + motion.duration + SETTLING
        for elapsed in Ticks(self._session, whole, PREVIEW_PERIOD, self._check):
            if elapsed < LEAD + motion.duration:
                self._previews.publish(preview_message(motion, clock.now(), start))
            took_over |= self._source == "path"
            self._progress.update(part[0] + (part[1] - part[0]) * elapsed / whole, "")
        if not took_over:
            raise CommandError(f"run '{name}': '{self._source}' drives, not this path")
        if not self._until(lambda: self._source == "none" and self._speed < STILL, ANSWER):
            raise CommandError(f"run '{name}': the robot does not come to rest")
        end, (x, y, theta) = motion.sample(motion.duration).pose, self.pose
        off = max(
            math.hypot(x - end[0], y - end[1]), abs(math.remainder(theta - end[2], math.tau))
        )
        if off <= OFF:
            return True
        self._until(lambda: False, FORGIVEN)
        return False

    def halt(self) -> None:
        """Ask for rest: a zero twist, which goes before any path."""
        for _ in range(3):
            message = TwistStamped() if self._stamped else Twist()
            if self._stamped:
                message.header.stamp = self._session.node.get_clock().now().to_msg()
                message.header.frame_id = "base_link"
            self._twists.publish(message)
        self._twists.wait_for_all_acked(Duration(seconds=1))

    def pose_at_rest(self) -> Triple | None:
        """Mean of the measured poses over some time; None if none came."""
        before = len(self.recording.truth)
        self._until(lambda: False, LOOK)
        rows = np.array(self.recording.truth[before:])
        if not len(rows):
            return None
        angle = math.atan2(np.sin(rows[:, 3]).mean(), np.cos(rows[:, 3]).mean())
        return float(rows[:, 1].mean()), float(rows[:, 2].mean()), angle

    def _until(self, condition: Callable[[], bool], timeout: float) -> bool:
        def checked() -> bool:
            self._check()
            return condition()

        return self._session.wait(checked, timeout)


def _pose(message: Odometry) -> Triple:
    position = message.pose.pose.position
    plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "measured position")
    return position.x, position.y, yaw(message.pose.pose.orientation)
