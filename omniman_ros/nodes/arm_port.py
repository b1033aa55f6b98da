"""The arm's part of `path_interpolator`: `joint_trajectory` in, `arm/joint_reference` out."""

from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from omniman_ros import arm_conversions, conversions
from omniman_ros.core import plausible
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.control import ControlWatch
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.axis_limits import AxisLimits
from omniman_ros.core.path.interpolator import PathState, Window
from omniman_ros.core.path.joint_interpolator import JointInterpolator
from omniman_ros.core.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.core.path.joint_points import JointPlanner, JointPoints
from omniman_ros.core.path.pace import Pace
from omniman_ros.core.path.parameters import TICK
from omniman_ros.core.preview import MAX_POINTS
from omniman_ros.nodes.runtime import OmnimanNode

Array = NDArray[np.float64]

POINT_BYTES = 64
"""A point takes less than this on the wire, besides its numbers."""
PLANNING, PLANNING_LEAST, ATTEMPTS = 1e-3, 0.03, 3
"""Planning is expected to take less for each point, and for any trajectory [s]; attempts."""
AT_REST = 0.02
"""Joint speed below which a trajectory may begin [rad/s]."""
LATE = 0.5
"""A stamp may be so old: the trajectory begins now [s]."""
LAG = 0.2
"""The arm may be where it was to be so long ago [s]."""


class Host(Protocol):
    """What the port asks of its node."""

    pace: Pace
    watch: ControlWatch

    def motion_time(self) -> float:
        """Motion time now [s]."""
        ...

    def cover(self, horizon: float) -> None:
        """Publish previews that reach so far [s], of all that moves."""
        ...


class ArmPort:
    """Message plumbing around `core.path.joint_interpolator.JointInterpolator`.

    Args:
        node: Where the topics are.
        host: The same, as the port sees it.
        arm, options: Parameters.
        horizon: How far previews reach [s].
        begun: Called when a trajectory has begun.

    Attributes:
        core: The interpolator.
        last: What happened last, in words.
    """

    def __init__(
        self, node: OmnimanNode, host: Host, arm: ArmParameters, options: JointTrajectoryOptions,
        horizon: float, begun: Callable[[], None],
    ) -> None:  # fmt: skip
        self._node, self._host, self._begun, self._horizon = node, host, begun, horizon
        self.core = JointInterpolator(AxisLimits.of_arm(arm), options)
        self.options = options
        self.last = "no trajectory yet"
        self._names = arm.joints
        self._states: bytes | None = None
        self._heard = float("-inf")
        self._silent = 0.0
        self._position: Array | None = None
        self._speed = 0.0
        self._wanted: deque[tuple[float, Array]] = deque()
        self._covered = float("inf")
        self._message = arm_conversions.joint_reference_message(
            arm.joints, int(horizon / TICK) + 1, TICK
        )
        self._reference: Publisher = node.create_publisher(
            JointTrajectory, "arm/joint_reference", QoSProfile(depth=1)
        )
        # Bytes: a huge trajectory is refused unpacked; states are needed only now and then.
        on_trajectory = node.guarded("joint_trajectory", self._on_trajectory)
        node.create_subscription(JointTrajectory, "joint_trajectory", on_trajectory, 10, raw=True)
        on_states = node.guarded("arm/joint_states", self._on_states)
        node.create_subscription(JointState, "arm/joint_states", on_states, 1, raw=True)

    @property
    def idle(self) -> bool:
        """Whether no trajectory is under way."""
        return self.core.state is PathState.IDLE

    def configure(self, arm: ArmParameters, options: JointTrajectoryOptions) -> None:
        """Take new parameters; they count from the next trajectory."""
        planner = JointPlanner(AxisLimits.of_arm(arm), options, TICK)
        self.core.planner, self.options = planner, options

    # ---- inputs -------------------------------------------------------------------------------

    def _on_states(self, data: bytes) -> None:
        self._states, self._heard = data, self._node.now()
        if not self.idle:
            self._measure()
            self._compare()

    def _measure(self) -> None:
        """Unpack what was heard last."""
        data, self._states = self._states, None
        if data is None:
            return
        message = deserialize_message(data, JointState)
        position, velocity, _ = conversions.joint_arrays(message, self._names)
        self._position = conversions.present(position, plausible.ANGLE, "position")
        self._speed = 0.0
        if velocity is not None:
            plausible.demand(velocity, plausible.SPEED, "velocity")
            self._speed = float(np.abs(velocity).max())
        self._silent = max(self._node.age(message.header.stamp), 0.0)

    def _compare(self) -> None:
        """Give up where the arm is not where it was to be."""
        if self._position is None or not self._wanted:
            return
        places = np.array([place for _, place in self._wanted])
        off = np.maximum(self._position - places.max(axis=0), places.min(axis=0) - self._position)
        k = int(off.argmax())
        if off[k] > self.options.following_error:
            self.give_up(f"{self._names[k]} is {off[k]:.3f} rad from its reference", brake=True)

    def _on_trajectory(self, data: bytes) -> str:
        most = self.options.max_points
        if len(data) > (POINT_BYTES + 32 * len(self._names)) * (most + 100):
            raise self._refused(f"{len(data) / 1e6:.0f} MB, at most {most} points are taken")
        try:
            message = deserialize_message(data, JointTrajectory)
            if not message.points:
                self._stop()
                return ""
            points = arm_conversions.joint_points(message, self._names, most)
            delay = self._delay(message.header.stamp)
            why = self._obstacle()
            if not why:
                self._begin(points, delay)
        except InputError as error:
            raise self._refused(str(error)) from error
        if why:
            self._refused(why)
        return why

    def _refused(self, why: str) -> InputError:
        self.last = f"a trajectory was refused: {why}"
        return InputError(why)

    def _stop(self) -> None:
        """Obey a trajectory without points: it ends the one under way."""
        if not self.idle:
            self.core.cancel(self._host.motion_time())

    def _delay(self, stamp: Time) -> float | None:
        """Time until a stamp [s]; None: now."""
        if stamp.sec == 0 and stamp.nanosec == 0:
            return None
        now = self._node.get_clock().now().nanoseconds
        delay = float((stamp.sec * 1_000_000_000 + stamp.nanosec - now) * 1e-9)
        if delay < -LATE:
            raise InputError(f"the stamp is {-delay:.2f} s old")
        if delay > self.options.max_delay:
            raise InputError(
                f"the stamp is {delay:.2f} s ahead, at most {self.options.max_delay:g} s"
            )
        return max(delay, 0.0)

    # ---- trajectories -------------------------------------------------------------------------

    def _obstacle(self) -> str:
        """Why none can begin, or an empty string."""
        if self._host.watch.stop:
            return self._host.watch.stop
        self._measure()
        if self._position is None:
            return "no arm/joint_states"
        age = self._node.now() - self._heard if self.idle else self._silent
        age = max(age, self._silent)
        if age > self.options.states_timeout:
            return f"arm/joint_states are {age:.2f} s old"
        return "" if self._held() or self._speed <= AT_REST or not self.idle else "the arm moves"

    def _held(self) -> bool:
        """Whether the arm is still where the last motion ended."""
        held, here = self.core.held, self._position
        if held is None or here is None:
            return False
        return bool((np.abs(held - here) <= self.options.start_tolerance).all())

    def _begin(self, points: JointPoints, delay: float | None) -> None:
        begun = self._node.now()
        lead = PLANNING_LEAST + PLANNING * len(points.positions)
        here = self.core.held if self._held() else self._position
        assert here is not None
        was_idle = self.idle
        for _ in range(ATTEMPTS):
            self._host.cover(2.0 * lead + self._horizon)  # what covers the planning
            now = self._host.motion_time()
            start = None
            if delay is not None:
                start = max(self._host.pace.motion(begun + delay), now)
            proposal = self.core.propose(points, here, now, lead, start)
            if self.core.take(proposal, self._host.motion_time()):
                break
            lead *= 2.0
        else:
            raise InputError("it could not be planned in time; pause first")
        if was_idle:
            self._silent, self._covered = 0.0, float("inf")
            self._wanted.clear()
        times = "its own" if points.times is not None else "computed"
        self.last = (
            f"{len(points.positions)} points in {proposal.curve.duration:.2f} s, times {times}"
        )
        self._node.get_logger().info(f"trajectory: {self.last}")
        self._begun()

    def give_up(self, why: str, *, brake: bool) -> None:
        """End the trajectory; the arm comes to rest.

        Args:
            why: In words.
            brake: Whether a last preview leads it to rest on its path; the receiver does by
                itself where it is stopped.
        """
        if self.idle:
            return
        self.last = f"the trajectory was given up: {why}"
        self._node.warn("trajectory given up", self.last)
        now = self._node.now()
        window = self._paced_stop(now) if brake else None
        self.core.abort()
        if window is not None:
            self._send(window)

    def _paced_stop(self, now: float) -> Window | None:
        pace = self._host.pace
        if pace.plain:
            return self.core.stop_window(now)
        # Slowed down already: the stop takes the same time in motion time, on the same path.
        window = self.core.stop_window(pace.motion(now))
        if window is None or pace.rate(now) <= 0.0:
            return None
        rate = pace.rate(now)
        times = now + (window.times - window.times[0]) / rate
        return Window(
            times, window.positions, window.velocities * rate, window.accelerations * rate**2
        )

    def look(self, elapsed: float) -> None:
        """Give up what is stopped or no longer measured; time [s] has passed since the last."""
        if self.idle:
            return
        self._silent += elapsed
        if self._host.watch.stop:
            self.give_up(self._host.watch.stop, brake=False)
        elif self._node.now() > self._covered:
            self.give_up("no preview in time", brake=False)
        elif self._silent > self.options.states_timeout:
            self.give_up(f"no arm/joint_states for {self._silent:.2f} s", brake=True)

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish the next preview, and notice an end."""
        before = self.core.state
        if before is PathState.IDLE:
            return
        self.publish(self._horizon)
        motion = self._host.motion_time()
        self.core.update(motion)
        if self.core.state is PathState.CANCELLING and self._host.pace.stands(self._node.now()):
            self.core.finish(motion)
        if self.idle:
            self.last = "cancelled" if before is PathState.CANCELLING else "arrived"
            self._node.get_logger().info(f"trajectory: {self.last}")

    def publish(self, horizon: float) -> None:
        """Publish a preview that reaches so far [s]."""
        if self.idle:
            return
        now = self._node.now()
        first = np.floor(now / TICK + 1e-6)
        times = TICK * (first + np.arange(max(int(horizon / TICK), 1) + 1, dtype=float))
        paced = self._host.pace.sample(times)
        window = Window(times, *paced.apply(*self.core.sample(paced.motion)))
        self._wanted.append((now, window.positions[0]))
        while self._wanted[0][0] < now - LAG - 2.0 * TICK:
            self._wanted.popleft()
        self._send(window)
        self._covered = float(times[min(len(times), MAX_POINTS) - 1])

    def _send(self, window: Window) -> None:
        message = self._message
        points = min(len(window.times), MAX_POINTS)
        if points != len(message.points) or window.times[1] - window.times[0] > 1.001 * TICK:
            step = float(window.times[1] - window.times[0])
            message = arm_conversions.joint_reference_message(self._names, points, step)
        arm_conversions.fill_joint_reference(message, self._node.stamp(window.times[0]), window)
        self._reference.publish(message)
