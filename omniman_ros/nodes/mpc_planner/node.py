"""Node `mpc_planner`: goals and obstacles in, a checked motion on `mpc/reference` out."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.headers import duration_message
from omniman_ros.conversions.poses import (
    goal_pose_from_message,
    goal_state_from_message,
    pose_message,
)
from omniman_ros.conversions.trajectories import preview_from_message
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.extras import PLANNING
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_log import LoggedMotion, MotionEvent
from omniman_ros.nodes.mpc_planner.inputs import (
    ArmConfigurationInterface,
    PlannerInputs,
)
from omniman_ros.nodes.mpc_planner.loop import (
    GoalAnchor,
    MotionPublisher,
    PlacedGoal,
    PlannerLoop,
    PlanPublisher,
)
from omniman_ros.nodes.mpc_planner.parameters import MpcPlannerParameters
from omniman_ros.nodes.navigation_action import NavigationKind, serve_navigation
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.goals import Goal, PoseGoal, TrajectoryGoal, goal_of_state

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.nodes.mpc_planner.compiled_functions import CompiledFunctions
    from omniman_ros.planning.planner import Planner


class GoalInterface:
    """Subscribes to `goal_pose`, `goal_state` and `goal_trajectory`."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        frames: FrameTransforms,
        loop: PlannerLoop,
    ) -> None:
        self._node, self._settings, self._frames = node, settings, frames
        self._loop = loop
        for kind, topic, convert in (
            (PoseStamped, "goal_pose", self._pose_goal),
            (Odometry, "goal_state", self._state_goal),
            (MultiDOFJointTrajectory, "goal_trajectory", self._trajectory_goal),
        ):
            submit = functools.partial(self._submit, convert)
            handler = frames.deferred(topic, lambda received: [received[1].header], submit)
            receive = functools.partial(self._receive, handler)
            node.create_subscription(kind, topic, node.guarded(topic, receive), 10)

    def submit_pose(self, message: PoseStamped) -> LoggedMotion:
        """Submit a pose to come to rest at; raise InputError if it is refused."""
        motion = self._loop.goals.receive(message.header.stamp)
        if refusal := self._submit(self._pose_goal, (motion, message)):
            raise InputError(refusal)
        return motion

    def _receive(self, handler: Callable[[Any], str | None], message: Any) -> str | None:
        return handler((self._loop.goals.receive(message.header.stamp), message))

    def _submit(self, convert: Callable[[Any], Goal], received: tuple[LoggedMotion, Any]) -> str:
        motion, message = received
        return self._loop.submit(motion, lambda: self._placed(message, convert))

    def _placed(self, message: Any, convert: Callable[[Any], Goal]) -> PlacedGoal:
        placement = self._frames.placement(message.header)
        goal = convert(message).displaced(placement.transform.planar())
        return PlacedGoal(placement.frame, goal)

    # Goals are converted within the frames of their own messages.

    def _pose_goal(self, message: PoseStamped) -> Goal:
        return PoseGoal(goal_pose_from_message(message, (_frame(message),)))

    def _state_goal(self, message: Odometry) -> Goal:
        names, frame, child = self._odom_names(), _frame(message), message.child_frame_id
        if child in names and frame not in names:
            raise InputError(f"its twist is in '{child}', its pose in '{frame[:40]}'")
        known = self._settings.value.frames.odom.beside(frame)
        pose, velocity = goal_state_from_message(message, known)
        return goal_of_state(pose, velocity)

    def _trajectory_goal(self, message: MultiDOFJointTrajectory) -> Goal:
        start = self._node.instant(message.header.stamp)
        preview = preview_from_message(message, start, (_frame(message),))
        now = self._node.now()
        if preview.end < now:
            raise InputError(f"the trajectory ended {now - preview.end:.2f} s ago")
        return TrajectoryGoal(preview)

    def _odom_names(self) -> tuple[str, ...]:
        return self._settings.value.frames.odom.names


def _frame(message: PoseStamped | Odometry | MultiDOFJointTrajectory) -> str:
    return str(message.header.frame_id).lstrip("/")


class GoalExecutor:
    """Hands goals of an action to the planner; see `NavigationExecutor`."""

    def __init__(
        self,
        node: OmnimanNode,
        goals: GoalInterface,
        loop: PlannerLoop,
        inputs: PlannerInputs,
        planner: "Planner",
        frame: str,
    ) -> None:
        self._node, self._goals, self._loop = node, goals, loop
        self._inputs, self._planner, self._frame = inputs, planner, frame

    def send(self, request: Any) -> LoggedMotion:
        """Drive to a goal's pose; raise InputError if it is refused."""
        if request.behavior_tree:
            raise InputError(f"behavior_tree must be empty, not '{request.behavior_tree}'")
        return self._goals.submit_pose(request.pose)

    def cancel(self, motion: LoggedMotion) -> None:
        """Bring the robot to rest if it waits for this goal or drives to it."""
        if motion.outcome is None:
            self._loop.cancel()

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the pose, and the rest of the way, into the feedback."""
        measured = self._inputs.measured
        if measured is None:
            return False
        feedback.current_pose.header.stamp = self._node.stamp(measured.time)
        feedback.current_pose.header.frame_id = self._frame
        feedback.current_pose.pose = pose_message(measured.pose)
        route = self._planner.route_planner
        if route is None or route.route is None:
            feedback.distance_remaining = self._planner.error(measured)[0]
        else:
            feedback.distance_remaining = route.remaining_length
            feedback.estimated_time_remaining = duration_message(route.remaining)
        return True


class MpcPlannerNode(OmnimanNode):
    """Serves the planner as a ROS node."""

    lookahead = 0.04  # about the time that a plan takes

    def __init__(self, **options: object) -> None:
        # Imported here, so that the parameters of this module can be read without casadi.
        from omniman_ros.planning.planner import Planner

        super().__init__("mpc_planner", **options)
        self.settings = ParameterSet(self, MpcPlannerParameters)
        p = self.settings.value
        self.core = Planner(p.core, anchored=p.output == "reference")
        self._monitor = StreamMonitor(p.restart, "mpc", ("body", "path"))
        self.frames = FrameTransforms(self, lambda: self.settings.value.frames)
        self.inputs = PlannerInputs(self, self.settings, self.frames, self.core, self._monitor)
        self.posture = ArmConfigurationInterface(self, self.settings)
        self.publisher = MotionPublisher(self, self.settings, self.core, self._monitor)
        plans = PlanPublisher(self, p.frames.odom.odom_frame, self.core)
        anchor = GoalAnchor(self.core, self.frames)
        self.loop = PlannerLoop(
            self,
            self.core,
            anchor,
            self.inputs,
            self.posture,
            self.publisher,
            plans,
            self._monitor,
        )
        self.settings.on_change(self._configure)
        self._status_publisher = self.create_publisher(DiagnosticStatus, "mpc/status", 10)
        goals = GoalInterface(self, self.settings, self.frames, self.loop)
        executor = GoalExecutor(
            self, goals, self.loop, self.inputs, self.core, p.frames.odom.odom_frame
        )
        self.actions = serve_navigation(
            self, NavigationKind.NAVIGATE_TO_POSE, p.navigate_action, executor
        )
        StreamMonitorInterface(self, self._monitor, self.loop.give_up_if_lost)
        for name, request in (
            ("pause", self.loop.pause),
            ("resume", self.loop.resume),
            ("cancel", self.loop.cancel),
        ):
            self.create_service(Trigger, f"~/{name}", functools.partial(self._serve, request))
        self._compiled: CompiledFunctions | None = None
        self._compile()
        self.every(p.period, self.tick)
        self.every(p.voltages_period, self.publisher.send_voltages)

    def _configure(self, new: MpcPlannerParameters) -> None:
        if new.output != self.settings.value.output and self.loop.is_moving:
            raise ParameterError(
                "output", new.output, "cannot change during a motion: cancel it first"
            )
        if new.core.robot != self.settings.value.core.robot and self.loop.is_moving:
            raise ParameterError(
                "robot", "new data", "cannot change during a motion: cancel it first"
            )
        solvers = self.core.solvers
        self.core.configure(new.core)
        if self.core.solvers is not solvers:
            self._compile()
        self.posture.configure(new)
        self.core.anchored = new.output == "reference"
        self.inputs.configure(new)
        self._monitor.silence = new.restart

    def _compile(self) -> None:
        """Have the functions of the present solvers compiled in the background."""
        from omniman_ros.nodes.mpc_planner import compiled_functions

        if self._compiled is not None:
            self._compiled.close()
        if self.settings.value.planner.compile == "auto":
            self._compiled = compiled_functions.CompiledFunctions(
                self.core.solvers,
                compiled_functions.default_folder(),
                self.get_logger().info,
            )

    def _serve(
        self,
        request: Callable[[], str],
        _: Trigger.Request,
        response: Trigger.Response,
    ) -> Trigger.Response:
        refusal = request()
        response.success = not refusal
        response.message = refusal or self.core.state.value
        self._publish_status()
        return response

    def tick(self) -> None:
        """Run one planning cycle, and publish the status."""
        self.loop.tick()
        self._publish_status()
        if self._compiled is not None:
            self._compiled.poll()

    def _publish_status(self) -> None:
        if not self._status_publisher.get_subscription_count():
            return
        self._status_publisher.publish(self.status_message(*self.status()))

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for `mpc/status` and the diagnostics."""
        core, loop, report = self.core, self.loop, self.core.report
        measured, route = self.inputs.measured, core.route_planner
        distance, angle = (0.0, 0.0) if measured is None else core.error(measured)
        why = core.blocked_by or report.reason
        values: list[tuple[str, object]] = [
            ("state", core.state.value),
            ("outcome", loop.goals.event.value),
            ("goals", loop.goals.counts[MotionEvent.STARTED]),
            ("refused", loop.goals.counts[MotionEvent.REFUSED]),
            ("distance_m", round(distance, 3)),
            ("angle_rad", round(angle, 3)),
            ("solve_ms", round(1e3 * loop.solve_time, 2)),
            ("slack_m", round(report.slack, 4)),
            ("cost_j", round(report.cost, 1)),
            ("energy_j", round(core.energy(), 1)),
            ("obstacles", len(self.inputs.surroundings.obstacles)),
            ("arm", self.posture.source(self.now()).value),
            ("led_by", "the goal" if route is None else route.source.value),
            ("plan_used", report.used),
            ("why", loop.silence or why),
            ("last", loop.goals.text),
        ]
        if loop.silence:
            return DiagnosticStatus.WARN, f"waits: {loop.silence}", values
        if core.state is PlannerState.BLOCKED:
            return DiagnosticStatus.WARN, f"blocked: {why or 'no clear way found'}", values
        if not core.active and loop.goals.is_trouble:
            return DiagnosticStatus.WARN, loop.goals.text, values
        return DiagnosticStatus.OK, core.state.value, values

    def begin_shutdown(self, reason: str) -> None:
        """Bring the robot to rest, and accept no other goal."""
        self.loop.begin_shutdown()
        self.frames.end_waiting()

    def destroy_node(self) -> None:
        """End what is being compiled, and the node."""
        if self._compiled is not None:
            self._compiled.close()
        super().destroy_node()

    @property
    def finished(self) -> bool:
        """Whether there is no goal, the motion is over, and all clients have their results."""
        is_driving = self.loop.is_moving or self.loop.goals.driven
        return not is_driving and all(action.idle for action in self.actions)

    @property
    def stop_timeout(self) -> float:
        """How long the robot may take to come to rest from now on [s], with a margin of 1 s."""
        return 1.0 + max(self.core.motion.end - self.now(), 0.0)


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros mpc_planner`."""
    return run(MpcPlannerNode, args, PLANNING)
