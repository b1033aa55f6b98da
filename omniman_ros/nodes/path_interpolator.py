"""Node `path_interpolator`: paths and joint trajectories in, streams of x, x', x'' out."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry, Path
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros import conversions
from omniman_ros.core import plausible
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.control import ControlWatch
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.path.interpolator import PathInterpolator, PathState, RefusedError, Window
from omniman_ros.core.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.core.path.pace import Demand, Pace
from omniman_ros.core.path.parameters import TICK, PathParameters
from omniman_ros.core.preview import MAX_POINTS
from omniman_ros.nodes.arm_port import ArmPort
from omniman_ros.nodes.control_port import ControlPort
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run
from omniman_ros.nodes.scaling_port import ScalingPort
from omniman_ros.nodes.stopping import LATCHED

Array = NDArray[np.float64]

POSE_BYTES = 160
"""A pose of a path takes less than this on the wire."""
PLANNING = 1e-4
"""Planning is expected to take less than this for each pose [s] ..."""
PLANNING_LEAST = 0.03
"""... and this for any path."""
ATTEMPTS = 3
"""To plan from a motion in time; each may take twice as long as the one before."""
AT_REST = 0.02
"""Speed below which a path may begin [m/s, rad/s]."""
TIME_BACK = 0.1
"""Simulated time that goes back by more than this ends a path [s]."""
PATIENCE = 5.0
"""How long a path waits for the robot to come to rest [s]."""
TROUBLE = ("a path", "the path", "a trajectory", "the trajectory")
"""What a warning in the diagnostics begins with."""
SLOWEST = 0.1
"""An end of the node waits for what is driven at this pace or faster."""


@dataclass(frozen=True, kw_only=True)
class PathInterpolatorParameters:
    """Parameters of the node: those of its core, of the stream, and frames."""

    core: PathParameters = inline()
    arm: ArmParameters
    joint_trajectory: JointTrajectoryOptions
    horizon: float = parameter(
        0.4, "How far each preview reaches; at its end the robot ramps to rest.",
        unit="s", low=0.1, high=5, read_only=True,
    )  # fmt: skip
    period: float = parameter(
        0.04, "Period of the previews.", unit="s", low=0.008, high=1, read_only=True
    )
    restart: float = parameter(
        1.2, "Silence after control was lost: longer than the controller's timeouts.cancelled.",
        unit="s", low=0.05, high=60,
    )  # fmt: skip
    odom_timeout: float = parameter(
        0.5, "Age at which odom is too old to begin a path, or to go on with one.",
        unit="s", low=0.02, high=10,
    )  # fmt: skip
    scaling_timeout: float = parameter(
        0.5, "Silence of arm/speed_scaling, once heard, after which a trajectory of the arm is "
        "given up, and new motions are not slowed.", unit="s", low=0.05, high=60,
    )  # fmt: skip
    odom_frame: str = parameter("odom", "Frame of odometry and references.", read_only=True)
    map_is_odom: bool = parameter(False, "Whether paths in `map` are taken for odom.")


class PathInterpolatorNode(OmnimanNode):
    """Message plumbing around `core.path.interpolator.PathInterpolator`, and the arm's port.

    Attributes:
        core: The platform's interpolator.
        arm: The arm's part.
        pace: How fast time passes for both; they are given motion time.
        watch: Who drives, and who is stopped.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("path_interpolator", **options)
        self.settings = ParameterSet(self, PathInterpolatorParameters)
        p = self.settings.value
        if 2.0 * p.period > p.horizon:
            raise ParameterError("period", p.period, "more than half of the horizon")
        self.core = PathInterpolator(p.core)
        self.watch = ControlWatch(p.restart)
        p.core.planner()  # what it would refuse, it refuses now
        self.pace = Pace(self._demand, TICK)
        self._held_still = False
        self._paced = float("-inf")
        self.settings.on_change(self._configure)
        self._pose: tuple[float, float, float] | None = None
        self._speed = 0.0
        self._heard = float("-inf")
        self._waiting: Callable[[], None] | None = None
        self._waits_until = 0.0
        self._ticked = self.now()
        self._silent = 0.0
        self._covered = float("inf")
        self._ending = False
        self._last = "no path yet"
        self._reference = self.create_publisher(
            MultiDOFJointTrajectory, "path/reference", QoSProfile(depth=1)
        )
        self._progress = self.create_publisher(Float64, "path_progress", 10)
        points = int(p.horizon / TICK) + 1
        self._message = conversions.reference_message(p.odom_frame, points, TICK)
        self.scaling = ScalingPort(self, self._scaled)
        self.arm = ArmPort(self, self, p.arm, p.joint_trajectory, p.horizon, self._begun)
        self._make_inputs()
        self.every(p.period, self.tick)

    def _make_inputs(self) -> None:
        # Bytes, so that a path of a million poses is refused before it is unpacked.
        on_path = self.guarded("path", self._on_path)
        self.create_subscription(Path, "path", on_path, 10, raw=True)
        self.create_subscription(Odometry, "odom", self.guarded("odom", self._on_odom), 1)
        on_health = self.guarded("wheel_health", self._on_health)
        self.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)
        ControlPort(self, self.watch, self._look)
        for name, request in (
            ("pause", self._pause), ("resume", self._resume), ("cancel", self._cancel),
        ):  # fmt: skip
            self.create_service(Trigger, f"~/{name}", self._service(request))

    def _configure(self, new: PathInterpolatorParameters) -> None:
        new.core.planner()  # what it would refuse, it refuses now
        self.arm.configure(new.arm, new.joint_trajectory)
        self.core.parameters = new.core
        self.watch.silence = new.restart

    # ---- inputs -------------------------------------------------------------------------------

    def _on_odom(self, message: Odometry) -> None:
        conversions.check_frame(message.header.frame_id, self.settings.value.odom_frame)
        twist = conversions.twist_array(message.twist.twist)
        place, theta = message.pose.pose.position, conversions.yaw(message.pose.pose.orientation)
        plausible.demand(np.array([place.x, place.y]), plausible.LENGTH, "position")
        self._silent = max(self.age(message.header.stamp), 0.0)
        self._heard = self.now() - self._silent
        self._pose = (place.x, place.y, theta)
        self._speed = float(abs(twist).max())

    def _on_health(self, message: DiagnosticStatus) -> None:
        """Drive with the limits that the controller has left, where a wheel is dead."""
        share = conversions.limits_share(message)
        if share > self.core.share:  # the controller was reset: it wants a silence
            self.watch.restart(self.now())
        if share != self.core.share:
            self.core.scale(share, self.motion_time())
            self.tick()

    def _on_path(self, data: bytes) -> str:
        p = self.settings.value
        most = p.core.path.max_poses
        if len(data) > POSE_BYTES * (most + 100):
            raise self._refused(f"{len(data) / 1e6:.0f} MB, at most {most} poses are taken")
        try:
            message = deserialize_message(data, Path)
            frames = (p.odom_frame, "map") if p.map_is_odom else (p.odom_frame,)
            poses = conversions.path_poses(message, frames, p.core.path.heading == "poses")
        except InputError as error:
            raise self._refused(str(error)) from error
        if self._ending:
            raise self._refused("the node ends")
        self._waiting = lambda: self._begin(poses)
        self._waits_until = self.now() + PATIENCE + self.watch.wait(self.now())
        return self._try_waiting()

    def _refused(self, why: str) -> InputError:
        self._last = f"a path was refused: {why}"
        return InputError(why)

    # ---- paths --------------------------------------------------------------------------------

    def _try_waiting(self) -> str:
        """Begin the path that waits, if it can be; returns why it never will."""
        if self._waiting is None:
            return ""
        why, now = self.watch.obstacle, self.now()
        if not why and self.core.state is PathState.IDLE:
            why = self._not_yet(now)
            if why and now < self._waits_until:
                self._last = f"a path waits: {why}"
                return ""
        begin, self._waiting = self._waiting, None
        if not why:
            try:
                begin()
            except InputError as error:
                why = str(error)
        if why:
            self._last = f"a path was refused: {why}"
        return why

    def _not_yet(self, now: float) -> str:
        """Why a path cannot begin from rest yet, or an empty string."""
        age = now - self._heard
        if self._pose is None:
            return "no odom"
        if age > self.settings.value.odom_timeout:
            return f"odom is {age:.2f} s old"
        if self._speed > AT_REST:
            return "the robot moves"
        return "control was lost a moment ago" if self.watch.wait(now) > 0.0 else ""

    def _begin(self, poses: Array) -> None:
        lead = PLANNING_LEAST + PLANNING * len(poses)
        for _ in range(ATTEMPTS):
            self.cover(2.0 * lead + self.settings.value.horizon)  # what covers the planning
            proposal = self.core.propose(poses, self._pose, self.motion_time(), lead)
            if self.core.take(proposal, self.motion_time()):
                break
            lead *= 2.0
        else:
            raise InputError("it could not be planned in time; pause first")
        plan = proposal.plan
        if proposal.since is None:
            self._silent, self._covered = 0.0, float("inf")
        self.watch.begin(self.now())
        self._last = (
            f"{len(poses)} poses in {plan.duration:.2f} s, {plan.duration / plan.bound:.3f} of "
            "what the limits allow without jerk limits"
        )
        self.get_logger().info(f"path: {self._last}")
        self._begun()

    # ---- platform and arm together ------------------------------------------------------------

    @property
    def _idle(self) -> bool:
        return self.core.state is PathState.IDLE and self.arm.idle

    @property
    def _state(self) -> PathState:
        """What it does: the platform's part, unless only the arm moves."""
        return self.arm.core.state if self.core.state is PathState.IDLE else self.core.state

    def motion_time(self) -> float:
        """Motion time now [s]; time itself where nothing was slowed."""
        now = self.now()
        if self._idle:
            if self.scaling.silent > self.settings.value.scaling_timeout:
                self.scaling.forget()
            self._held_still = False
            self.pace.reset(now, self.scaling.value)
        return self.pace.motion(now)

    def _demand(self, times: Array) -> Demand:
        parts = [part for part in (self.core.demand(times), self.arm.core.demand(times)) if part]
        if not parts:
            return Demand.none(len(times))
        return parts[0].beside(parts[1]) if len(parts) == 2 else parts[0]

    def _set_pace(self) -> None:
        now = self.now()
        self.pace.refresh(now)  # what moves may have changed since
        self.pace.aim(0.0 if self._held_still else self.scaling.value, now)

    def _begun(self) -> None:
        """Send the first preview of a new motion."""
        self._held_still = False
        self.tick()

    def _scaled(self) -> None:
        """Slow down at once; what comes in a burst waits for the next tick."""
        if not self._idle and self.now() - self._paced >= TICK:
            self._paced = self.now()
            self.tick()

    def _look_at_arm(self, elapsed: float) -> None:
        self.scaling.pass_time(elapsed)
        silent = self.scaling.silent
        if silent > self.settings.value.scaling_timeout and not self.arm.idle:
            self.arm.give_up(f"no arm/speed_scaling for {silent:.2f} s", brake=True)
        self.arm.look(elapsed)

    def _done(self) -> float:
        """How much is behind of what goes on, 0 to 1: of the part that has most before it."""
        now = self.motion_time()
        parts = [core for core in (self.core, self.arm.core) if core.state is not PathState.IDLE]
        return min(core.progress(now) for core in parts)

    def _start_over(self) -> None:
        """Time went back: what was heard before says nothing about now."""
        self._give_up("time went back")
        self.arm.give_up("time went back", brake=False)
        now = self.now()
        self.watch.restart(now)
        self._heard, self._waits_until = float("-inf"), now + PATIENCE + self.watch.wait(now)

    def _watch_out(self) -> None:
        """Give the path up if it is no longer ours to drive."""
        why = self.watch.lost(self.now())
        if why:
            self._give_up(why)

    def _look(self) -> None:
        """Give up what is stopped or has lost control, arm and path each for its own reasons."""
        self._watch_out()
        self.arm.look(0.0)

    def _give_up(self, why: str) -> None:
        if self.core.state is not PathState.IDLE:
            self._last = f"the path was given up: {why}"
            self.warn("given up", self._last)
            self.core.abort()
            self.watch.end(lost=True)

    def _pause(self, now: float) -> None:
        self._ask(self.core.pause, self.arm.core.pause, now)
        self._held_still = self.pace.stands(self.now())

    def _resume(self, now: float) -> None:
        self._ask(self.core.resume, self.arm.core.resume, now)
        self._held_still = False

    def _cancel(self, now: float) -> None:
        waits, self._waiting = self._waiting is not None, None
        if waits and self.core.state is PathState.IDLE:
            self._last = "cancelled"
            if not self.arm.idle:
                self.arm.core.cancel(now)
        else:
            self._ask(self.core.cancel, self.arm.core.cancel, now)

    def _ask(
        self, platform: Callable[[float], None], arm: Callable[[float], None], now: float
    ) -> None:
        """Ask both; it is refused if it fits neither."""
        if self.arm.idle:
            return platform(now)
        if self.core.state is PathState.IDLE:
            return arm(now)
        try:
            platform(now)
        except RefusedError:
            return arm(now)
        with contextlib.suppress(RefusedError):
            arm(now)
        return None

    def _service(self, request: Callable[[float], None]) -> Callable[..., Trigger.Response]:
        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                request(self.motion_time())
            except RefusedError as error:
                response.success, response.message = False, str(error)
            else:
                self.tick()
                response.success, response.message = True, self._state.value
            return response

        return serve

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """Publish the next preview and the progress."""
        late, self._ticked = self.now() - self._ticked, self.now()
        if late < -TIME_BACK:
            self._start_over()
        elif self.now() > self._covered:
            self._give_up(f"no preview for {late:.2f} s")
        elif self._silent > self.settings.value.odom_timeout:
            self._give_up(f"no odom for {self._silent:.2f} s")
        # While this node is held up, it is not odom that is silent.
        self._silent += min(max(late, 0.0), 2.0 * self.settings.value.period)
        self._watch_out()
        elapsed = min(max(late, 0.0), 2.0 * self.settings.value.period)
        self._look_at_arm(elapsed)
        refusal = self._try_waiting()
        if refusal:
            self.warn("path refused", f"path not used: {refusal}")
        if self._idle:
            return
        self._progress.publish(Float64(data=self._done()))
        self._set_pace()
        self._tick_platform()
        self.arm.tick()

    def _tick_platform(self) -> None:
        now, before = self.motion_time(), self.core.state
        if before is PathState.IDLE:
            return
        self._publish(self.settings.value.horizon)
        try:
            self.core.update(now)
        except InputError as error:
            self._last = f"a path was paused: {error}"
            self.warn("path paused", self._last)
        if before is PathState.SLOWING and self.core.state is PathState.FOLLOWING:
            self._publish(self.settings.value.horizon)  # it goes on before the next tick
        if before is PathState.CANCELLING and self.pace.stands(self.now()):
            self.core.abort()  # it is at rest where it is
        if self.core.state is PathState.IDLE:
            self.watch.end(lost=False)
            self._last = "cancelled" if before is PathState.CANCELLING else "arrived"
            self.get_logger().info(f"path: {self._last}")

    def _publish(self, horizon: float) -> None:
        now = self.now()
        window = self._window(now, horizon)
        if window is None:
            return
        message = self._message
        if len(window.times) != len(message.points):
            frame = self.settings.value.odom_frame
            points = min(len(window.times), MAX_POINTS)
            message = conversions.reference_message(frame, points, TICK)
        conversions.fill_reference(message, self.stamp(window.times[0]), window)
        self._reference.publish(message)
        self._covered = float(window.times[len(message.points) - 1])
        self.watch.sent(now)

    def _window(self, now: float, horizon: float) -> Window | None:
        """The platform's stream from now to a horizon [s] later; None if it rests."""
        if self.pace.plain or self.core.state is PathState.IDLE:
            return self.core.window(now, horizon)
        first = np.floor(now / TICK + 1e-6)
        times = TICK * (first + np.arange(max(int(horizon / TICK), 1) + 1, dtype=float))
        paced = self.pace.sample(times)
        return Window(times, *paced.apply(*self.core.sample(paced.motion)))

    def cover(self, horizon: float) -> None:
        """Publish previews that reach so far [s], of all that moves."""
        if self.core.state is not PathState.IDLE:
            self._publish(horizon)
        self.arm.publish(horizon)

    # ---- life ---------------------------------------------------------------------------------

    def begin_shutdown(self, reason: str) -> None:
        """Come to rest on the path; no other is taken."""
        self._ending, self._waiting = True, None
        now = self.motion_time()
        if not self.arm.idle:
            self.arm.core.cancel(now)
        if self.core.state is not PathState.IDLE:
            self.core.cancel(now)
        if not self._idle:
            self.tick()

    @property
    def finished(self) -> bool:
        """Whether no path and no trajectory is driven."""
        return self._idle

    @property
    def patience(self) -> float:
        """Time of a stop from here [s], and a second."""
        now = self.motion_time()
        motion = self.core.remaining(now) + self.settings.value.core.path.settle
        pace = max(min(self.pace.rate(self.now()), self.scaling.value), SLOWEST)
        return 1.0 + max(motion, self.arm.core.remaining(now)) / pace

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        now, core, arm = self.motion_time(), self.core, self.arm
        values: list[tuple[str, object]] = [
            ("state", core.state.value),
            ("path_progress", round(core.progress(now), 4)),
            ("remaining_s", round(core.remaining(now), 2)),
            ("arm", arm.core.state.value),
            ("arm_progress", round(arm.core.progress(now), 4)),
            ("arm_last", arm.last),
            ("speed_scaling", round(self.scaling.value, 4)),
            ("last", self._last),
        ]
        for state, text in ((core.state, self._last), (arm.core.state, arm.last)):
            if state is PathState.IDLE and text.startswith(TROUBLE):
                return DiagnosticStatus.WARN, text, values
        return DiagnosticStatus.OK, self._state.value, values


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros path_interpolator`."""
    return run(PathInterpolatorNode, args)
