"""Node `mpc_planner`: goals and obstacles in, a checked motion on `mpc/reference` out."""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from omniman_ros import conversions
from omniman_ros.core.control import ControlWatch
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.nodes import map_port, obstacle_port
from omniman_ros.nodes.control_port import ControlPort
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run
from omniman_ros.nodes.stopping import LATCHED
from omniman_ros.planning import availability
from omniman_ros.planning.cycle import Measured, PlannerState
from omniman_ros.planning.ellipses import Ellipses
from omniman_ros.planning.goals import Goal, PoseGoal, StateGoal, TrajectoryGoal
from omniman_ros.planning.obstacles import ObstacleSet
from omniman_ros.planning.parameters import PlannerParameters

Array = NDArray[np.float64]

PATIENCE = 5.0
"""How long a goal waits until the robot can be driven [s]."""
TIME_BACK = 0.1
"""Simulated time that goes back by more than this ends a motion [s]."""
SHOWN = (0.5, 1.0, 1.5)
"""How far ahead predicted obstacles are shown [s]."""


@dataclass(frozen=True, kw_only=True)
class MpcPlannerParameters:
    """Parameters of the node: those of its core, of the stream, and frames."""

    core: PlannerParameters = inline()
    output: str = parameter(
        "reference", "What drives the robot: `mpc/reference`, which the platform controller "
        "follows, or `mpc/voltages`. Only at rest.", choices=("reference", "voltages"),
    )  # fmt: skip
    period: float = parameter(
        0.05, "Period of the planning.", unit="s", low=0.01, high=1, read_only=True
    )
    voltages_period: float = parameter(
        0.01, "Period of the voltages.", unit="s", low=0.005, high=0.05, read_only=True
    )
    restart: float = parameter(
        1.2, "Silence after control was lost: longer than the controller's timeouts.cancelled.",
        unit="s", low=0.05, high=60,
    )  # fmt: skip
    odom_timeout: float = parameter(
        0.3, "Age at which odom is too old to drive by: the goal is given up.",
        unit="s", low=0.02, high=10,
    )  # fmt: skip
    odom_frame: str = parameter("odom", "Frame of odometry and references.", read_only=True)
    map_is_odom: bool = parameter(
        False, "Whether goals, obstacles and maps in `map` are taken for odom."
    )
    map_threshold: int = parameter(
        50, "A cell of the map of this many percent or more is occupied.",
        unit="%", low=1, high=100, read_only=True,
    )  # fmt: skip
    map_unknown_is_free: bool = parameter(
        False, "Whether the robot may go where the map knows nothing.", read_only=True
    )

    def __post_init__(self) -> None:
        if self.core.safety.deadline > self.period:
            raise ParameterError(
                "safety.deadline", self.core.safety.deadline, f"above the period {self.period:g} s"
            )


class MpcPlannerNode(OmnimanNode):
    """Message plumbing around `planning.planner.Planner`."""

    def __init__(self, **options: object) -> None:
        # Here, so that a machine without casadi can import this module for its parameters.
        from omniman_ros.planning.planner import Planner

        super().__init__("mpc_planner", **options)
        self.settings = ParameterSet(self, MpcPlannerParameters)
        p = self.settings.value
        self.core = Planner(p.core, anchored=p.output == "reference")
        self.obstacles = ObstacleSet(p.core.obstacles)
        self.watch = ControlWatch(p.restart, "mpc", ("path",))
        self.settings.on_change(self._configure)
        self._measured: Measured | None = None
        self._waiting: tuple[Goal, float] | None = None
        self._streaming = False
        self._ending = False
        self._ticked = self.now()
        self._solved = math.nan
        self._held = ""
        self._goals = self._refused = 0
        self._last = "no goal yet"
        self._reference = self.create_publisher(
            MultiDOFJointTrajectory, "mpc/reference", QoSProfile(depth=1)
        )
        self._voltages = self.create_publisher(JointState, "mpc/voltages", QoSProfile(depth=1))
        self._plan = self.create_publisher(Path, "mpc/plan", 10)
        self._route = self.create_publisher(Path, "mpc/route", 10)
        self._predicted = self.create_publisher(MarkerArray, "mpc/predicted_obstacles", 10)
        self._status_out = self.create_publisher(DiagnosticStatus, "mpc/status", 10)
        self._make_inputs()
        self.every(p.period, self.tick)
        self.every(p.voltages_period, self._stream)

    def _make_inputs(self) -> None:
        def subscribe(kind: type, name: str, handler: Callable[..., str | None], n: int) -> None:
            self.create_subscription(kind, name, self.guarded(name, handler), n)

        subscribe(PoseStamped, "goal_pose", self._on_pose, 10)
        subscribe(Odometry, "goal_state", self._on_state, 10)
        subscribe(MultiDOFJointTrajectory, "goal_trajectory", self._on_trajectory, 10)
        subscribe(MarkerArray, "obstacles", self._on_obstacles, 50)
        subscribe(Odometry, "odom", self._on_odom, 1)
        on_map = self.guarded("map", self._on_map)
        self.create_subscription(OccupancyGrid, "map", on_map, LATCHED)
        on_health = self.guarded("wheel_health", self._on_health)
        self.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)
        ControlPort(self, self.watch, self._watch_out)
        for name, request in (
            ("pause", self._pause), ("resume", self._resume), ("cancel", self._cancel),
        ):  # fmt: skip
            self.create_service(Trigger, f"~/{name}", self._service(request))

    def _configure(self, new: MpcPlannerParameters) -> None:
        if new.output != self.settings.value.output and self._moving:
            raise ParameterError("output", new.output, "the robot is on its way: cancel first")
        if new.core.robot != self.settings.value.core.robot and self._moving:
            raise ParameterError("robot", "new data", "the robot is on its way: cancel first")
        self.core.configure(new.core)
        self.core.anchored = new.output == "reference"
        self.obstacles.configure(new.core.obstacles)
        self.watch.silence = new.restart

    @property
    def _moving(self) -> bool:
        return self.core.active or self.core.motion.end > self.now()

    @property
    def _frames(self) -> tuple[str, ...]:
        p = self.settings.value
        return (p.odom_frame, "map") if p.map_is_odom else (p.odom_frame,)

    # ---- inputs -------------------------------------------------------------------------------

    def _on_odom(self, message: Odometry) -> None:
        conversions.check_frame(message.header.frame_id, self.settings.value.odom_frame)
        place, theta = message.pose.pose.position, conversions.yaw(message.pose.pose.orientation)
        self._measured = Measured(
            self.now() - max(self.age(message.header.stamp), 0.0),
            np.array([place.x, place.y, theta]),
            conversions.twist_array(message.twist.twist),
        )

    def _on_obstacles(self, message: MarkerArray) -> str:
        complaints = obstacle_port.hear(self, message, self.obstacles, self._frames)
        more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
        return complaints[0] + more if complaints else ""

    def _on_map(self, message: OccupancyGrid) -> None:
        p = self.settings.value
        grid = map_port.grid(message, self._frames, p.map_threshold, p.map_unknown_is_free)
        self.core.chart(grid)
        length, width = grid.size
        self.get_logger().info(f"map taken: {length:.1f} x {width:.1f} m")

    def _on_health(self, message: DiagnosticStatus) -> None:
        """Drive with the limits that the controller has left, where a wheel is dead."""
        share = conversions.limits_share(message)
        if share > self.core.share:  # the controller was reset: it wants a silence
            self.watch.restart(self.now())
        self.core.scale(share)

    def _on_pose(self, message: PoseStamped) -> str:
        return self._take_goal(lambda: PoseGoal(conversions.goal_pose(message, self._frames)))

    def _on_state(self, message: Odometry) -> str:
        def goal() -> Goal:
            pose, velocity = conversions.goal_state(message, self._frames)
            return StateGoal(pose, velocity) if velocity.any() else PoseGoal(pose)

        return self._take_goal(goal)

    def _on_trajectory(self, message: MultiDOFJointTrajectory) -> str:
        def goal() -> Goal:
            start = self.now() - self.age(message.header.stamp)
            preview = conversions.preview(message, start, self._frames)
            if preview.end < self.now():
                raise InputError(f"it ended {self.now() - preview.end:.2f} s ago")
            return TrajectoryGoal(preview)

        return self._take_goal(goal)

    def _take_goal(self, make: Callable[[], Goal]) -> str:
        try:
            if self._ending:
                raise InputError("the node ends")
            goal = make()
        except InputError as error:
            self._refuse(str(error))
            raise
        self._dismiss_source()
        self._waiting = goal, self.now() + PATIENCE + self.watch.wait(self.now())
        return self._try_waiting()

    def _dismiss_source(self) -> None:
        """Wait for a silent source no longer if it is gone from the graph: a goal says so.

        A motion that is under way stops and stays stopped: nobody has looked since.
        """
        if self.obstacles.silent(self.now()) and not self.count_publishers("obstacles"):
            self.obstacles.dismiss()
            if not self.obstacles.silent(self.now()):
                self.warn(
                    "source gone", "the source of obstacles is gone: driving by what is known"
                )

    def _refuse(self, why: str) -> str:
        self._last = f"a goal was refused: {why}"
        self._refused += 1
        return why

    # ---- goals --------------------------------------------------------------------------------

    def _try_waiting(self) -> str:
        """Go for the goal that waits, if it can be; returns why it never will."""
        if self._waiting is None:
            return ""
        (goal, until), now = self._waiting, self.now()
        why = self.watch.obstacle
        if not why:
            why = self._not_yet(now)
            if why and now < until:
                self._last = f"a goal waits: {why}"
                return ""
        self._waiting = None
        if not why:
            assert self._measured is not None
            try:
                self.core.drive(goal, self._measured, self.obstacles.ellipses(now))
            except InputError as error:
                why = str(error)
        if why:
            return self._refuse(why)
        self._last = self._held = ""
        self._goals += 1
        self.get_logger().info("goal taken")
        return ""

    def _not_yet(self, now: float) -> str:
        """Why a goal cannot be driven to yet, or an empty string."""
        if self._measured is None:
            return "no odom"
        age = now - self._measured.time
        if age > self.settings.value.odom_timeout:
            return f"odom is {age:.2f} s old"
        if self.watch.wait(now) > 0.0:
            return "control was lost a moment ago"
        return self.obstacles.silent(now)

    def _watch_out(self) -> None:
        """Give the goal up if the motion is no longer ours to drive."""
        why = self.watch.lost(self.now())
        if not why and self.core.goal is not None:  # it stands, and nothing of it is followed
            why = self.watch.obstacle
        if why:
            self._give_up(why)

    def _give_up(self, why: str) -> None:
        """Forget goal and motion: nothing more is sent."""
        self._say_given_up(why)
        self.core.abort(self.now() - 1.0, self._measured)  # at rest, and that long since
        self._streaming = False
        self.watch.end(lost=True)

    def _say_given_up(self, why: str) -> None:
        self._held = ""
        if self.core.goal is not None:
            self._last = f"the goal was given up: {why}"
            self.warn("given up", self._last)

    def _pause(self) -> str:
        if not self.core.active:
            return f"nothing to pause: {self.core.state.value}"
        self._held = ""
        self.core.pause(self.now())
        self._send_reference(self.now())
        return ""

    def _resume(self) -> str:
        if self._measured is None or not self.core.resume(self._measured):
            return f"nothing to resume: {self.core.state.value}"
        return ""

    def _cancel(self) -> str:
        if self._waiting is None and self.core.goal is None:
            return f"nothing to cancel: {self.core.state.value}"
        self._waiting = None
        self._brake_for_good()
        self._last = "cancelled"
        return ""

    def _brake_for_good(self) -> None:
        self._held = ""
        self.core.cancel(self.now())
        self._send_reference(self.now())

    def _service(self, request: Callable[[], str]) -> Callable[..., Trigger.Response]:
        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            refusal = request()
            response.success = not refusal
            response.message = refusal or self.core.state.value
            self._send_status()
            return response

        return serve

    # ---- output -------------------------------------------------------------------------------

    def tick(self) -> None:
        """One cycle: plan, check, send."""
        now = self.now()
        late, self._ticked = now - self._ticked, now
        if late < -TIME_BACK:
            self._start_over(now)
        self._watch_out()
        refusal = self._try_waiting()
        if refusal:
            self.warn("goal refused", f"goal not used: {refusal}")
        measured = self._measured
        if self.core.active and measured is not None:
            age = now - measured.time
            if age > self.settings.value.odom_timeout:
                self._say_given_up(f"odom is {age:.2f} s old")
                self._brake_for_good()
            else:
                self._cycle(now, measured)
        else:
            self._run_out(now)
        self._send_status()

    def _cycle(self, now: float, measured: Measured) -> None:
        silent = self.obstacles.silent(now)
        around = self.obstacles.ellipses(now)
        if silent:
            if not self._held:
                self.core.brake(now)
            self._held = silent
            self.warn("obstacles silent", f"the robot stops: {silent}")
            self._send_reference(now)
            return
        self._held = ""
        proposal = self.core.propose(now, measured, around)
        done = self.now()
        self._solved = done - now
        self.core.take(proposal, done, measured, around)
        report = self.core.report
        if report.why:
            self._last = f"last plan not used: {report.why}"
            self.warn("plan", self._last)
        if self.core.state is PlannerState.ARRIVED:
            self._last = "arrived"
            self.get_logger().info("goal reached")
        self._send_reference(done)
        self._show(done, around)
        self.core.look(done, around)

    def _run_out(self, now: float) -> None:
        """Come to the end of the motion without a goal; what is in the way still counts."""
        if self.core.motion.end > now and self._measured is not None:
            if self.obstacles.silent(now):
                self.core.brake(now)
            else:
                self.core.coast(now, self._measured, self.obstacles.ellipses(now))
        self._send_reference(now)

    def _send_reference(self, now: float) -> None:
        """Send the motion from now on, unless voltages drive it; a stream ends with its motion.

        The controller lets go of a robot that stands: that is no loss of control.
        """
        motion, volts = self.core.motion, self.settings.value.output == "voltages"
        self._streaming = volts and self.core.active and self.core.voltages(now) is not None
        if motion.end <= now:
            self.watch.end(lost=False)
        if motion.end <= now or self._streaming:
            return
        preview = self.core.preview
        # However short: what ends on its way to the controller would be stale there.
        part = preview.between(now, max(preview.end, now + self.settings.value.period))
        message = conversions.preview_message(
            self.settings.value.odom_frame, self.stamp(now), part.times, part.poses,
            part.velocities,
        )  # fmt: skip
        self._reference.publish(message)
        self.watch.begin(now)
        self.watch.sent(now)

    def _stream(self) -> None:
        """Send the voltages of now, where they drive."""
        if not self._streaming:
            return
        now = self.now()
        volts = self.core.voltages(now + 0.5 * self.settings.value.voltages_period)
        if volts is None:
            self._send_reference(now)
            return
        message = JointState(name=list(self.settings.value.core.robot.wheels.names))
        message.header.stamp = self.stamp(now)
        message.effort = volts.tolist()
        self._voltages.publish(message)
        self.watch.begin(now)
        self.watch.sent(now)

    def _show(self, now: float, around: Ellipses) -> None:
        frame = self.settings.value.odom_frame
        motion = self.core.motion
        if self._plan.get_subscription_count():
            part = motion.between(now, max(motion.end, now + 0.01))
            plan = conversions.path_message(part.poses, frame)
            plan.header.stamp = self.stamp(now)
            self._plan.publish(plan)
        guide = self.core.guide
        if self._route.get_subscription_count() and guide is not None and guide.route is not None:
            way = conversions.path_message(guide.route.poses, frame)
            way.header.stamp = self.stamp(now)
            self._route.publish(way)
        if self._predicted.get_subscription_count():
            markers = conversions.ellipse_markers(
                around, now + np.array(SHOWN), frame, self.stamp(now)
            )
            self._predicted.publish(markers)

    def _start_over(self, now: float) -> None:
        """Time went back: what was heard before says nothing about now."""
        self._give_up("time went back")
        self.watch.restart(now)
        self._measured = None
        if self._waiting is not None:
            self._waiting = self._waiting[0], now + PATIENCE + self.watch.wait(now)

    # ---- life ---------------------------------------------------------------------------------

    def _send_status(self) -> None:
        if not self._status_out.get_subscription_count():
            return
        level, message, values = self.status()
        self._status_out.publish(
            DiagnosticStatus(
                level=level, name=self.get_fully_qualified_name(), message=message,
                values=[KeyValue(key=key, value=str(value)) for key, value in values],
            )
        )  # fmt: skip

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for `mpc/status` and the diagnostics."""
        core, report = self.core, self.core.report
        distance, angle = (0.0, 0.0) if self._measured is None else core.error(self._measured)
        values: list[tuple[str, object]] = [
            ("state", core.state.value),
            ("goals", self._goals),
            ("refused", self._refused),
            ("distance_m", round(distance, 3)),
            ("angle_rad", round(angle, 3)),
            ("solve_ms", round(1e3 * self._solved, 2)),
            ("slack_m", round(report.slack, 4)),
            ("cost_j", round(report.cost, 1)),
            ("energy_j", round(core.energy(), 1)),
            ("obstacles", len(self.obstacles)),
            ("led_by", "the goal" if core.guide is None else core.guide.state),
            ("plan_used", report.used),
            ("why", self._held or report.why),
            ("last", self._last),
        ]
        message = core.state.value
        level = DiagnosticStatus.OK
        if self._held:
            level, message = DiagnosticStatus.WARN, f"waits: {self._held}"
        elif core.state is PlannerState.BLOCKED:
            lost = "" if core.guide is None else core.guide.lost
            why = lost or "no clear way found"
            level, message = DiagnosticStatus.WARN, f"blocked: {why}"
        elif not core.active and self._last.startswith(("a goal", "the goal")):
            level, message = DiagnosticStatus.WARN, self._last
        return level, message, values

    def begin_shutdown(self, reason: str) -> None:
        """Come to rest; no other goal is taken."""
        self._ending, self._waiting = True, None
        if self.core.goal is not None:
            self._brake_for_good()

    @property
    def finished(self) -> bool:
        """Whether nothing is driven."""
        return not self._moving

    @property
    def patience(self) -> float:
        """Time of a stop from here [s], and a second."""
        return 1.0 + max(self.core.motion.end - self.now(), 0.0)


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros mpc_planner`."""
    if not availability.is_available():
        print(f"cannot start: {availability.HINT}", file=sys.stderr)
        return 1
    return run(MpcPlannerNode, args)
