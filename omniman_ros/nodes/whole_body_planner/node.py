"""Node `whole_body_planner`: motions of the whole body while platform and arm avoid obstacles."""

from diagnostic_msgs.msg import DiagnosticStatus
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.extras import PLANNING
from omniman_ros.motion.path.interpolator import RefusedError
from omniman_ros.motion.path.trajectory_goal import TrajectoryActionOptions
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.nodes.navigation_action import (
    NavigationAction,
    NavigationKind,
    serve_navigation,
)
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.path_interpolator.motions import MotionCoordinator
from omniman_ros.nodes.path_interpolator.node import TrajectoryAction, serve_actions
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.whole_body_planner.avoidance import AvoidanceInterface
from omniman_ros.nodes.whole_body_planner.joint_goals import JointGoalInterface
from omniman_ros.nodes.whole_body_planner.named_surroundings import NamedSurroundings
from omniman_ros.nodes.whole_body_planner.parameters import WholeBodyPlannerParameters
from omniman_ros.nodes.whole_body_planner.tool_tasks import (
    ToolGoalExecutor,
    ToolPathExecutor,
    ToolTaskInterface,
)
from omniman_ros.planning.whole_body.obstruction import status_values

SHOW_PERIOD = 0.2  #: Period of `body/plan` [s]
SOURCE = "body"  #: Value of `active_source` while the node drives the platform


class BodyCoordinator(MotionCoordinator[WholeBodyPlannerParameters]):
    """Runs the paths, goals and holds of the tool, and goals of the joints."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[WholeBodyPlannerParameters],
        period: float,
    ) -> None:
        # Imported here, so that the parameters of the node can be read without casadi.
        from omniman_ros.planning.whole_body.avoidance_motion import AvoidanceMotion

        p = settings.value
        motion = AvoidanceMotion(WholeBodyLimits.of_whole_body(p.core, p.arm))
        super().__init__(node, settings, (motion,), SOURCE, period)
        self.surroundings = NamedSurroundings(node, self.frames, p.surroundings)
        self.whole_body = AvoidanceInterface(self, motion, self.surroundings)
        self.interfaces = (self.whole_body,)
        self.tool = ToolTaskInterface(self, self.whole_body)
        self.joints = JointGoalInterface(self, self.tool)
        self.waiting = {"motion": self.tool}
        self.serve("hold", self.hold, self.tool.log)

    def configure(self, new: WholeBodyPlannerParameters) -> None:
        """Set new parameters, which apply from the next path on."""
        self.whole_body.configure(new)
        self.surroundings.configure(new.surroundings.obstacles, new.surroundings.map_reading)
        self.configure_streams(new)

    def scale_limits(self, scale: float) -> None:
        """Scale the limits of the platform, 0 to 1; see the base class."""
        self.whole_body.limit_scale = scale
        self.slow_down()

    def hold(self) -> None:
        """Hold the tool where it is, or raise RefusedError if no motion may begin."""
        if self.is_ending:
            raise RefusedError("the node is shutting down")
        if why := self.tool.take(self.whole_body.hold_planner, "a hold of the tool"):
            raise RefusedError(why)

    def tick(self) -> None:
        """Supervise the motion, start a path that waits, plan, and publish previews."""
        if self.odom.pose is not None:
            self.surroundings.update_map(self.odom.pose)
        self.supervise()
        if not self.time_base.idle:
            self.whole_body.plan()
            self.stream()


class WholeBodyPlannerNode(OmnimanNode):
    """Serves motions of the whole body among obstacles as a ROS node."""

    lookahead = 0.04  # about the time that a plan takes

    def __init__(self, **options: object) -> None:
        # Imported here, so that the parameters of this module can be read without casadi.
        from omniman_ros.planning.whole_body.controller import PERIOD

        super().__init__("whole_body_planner", **options)
        self.settings = ParameterSet(self, WholeBodyPlannerParameters)
        self.motions = BodyCoordinator(self, self.settings, PERIOD)
        self.settings.on_change(self.motions.configure)
        p, tool = self.settings.value, self.motions.tool
        goals, paths = ToolGoalExecutor(tool), ToolPathExecutor(tool)
        self.actions: tuple[NavigationAction | TrajectoryAction, ...] = (
            *serve_navigation(self, NavigationKind.NAVIGATE_TO_POSE, p.goal_action, goals),
            *serve_navigation(self, NavigationKind.FOLLOW_PATH, p.path_action, paths),
            *serve_actions(self, {p.joint_action: self.motions.joints}, TrajectoryActionOptions()),
        )
        self._status_publisher = self.create_publisher(DiagnosticStatus, "body/status", 10)
        self._plan_publisher = self.create_publisher(JointTrajectory, "body/plan", 1)
        self.every(PERIOD, self._tick)
        self.every(SHOW_PERIOD, self._publish_plan)

    def _tick(self) -> None:
        self.motions.tick()
        if self._status_publisher.get_subscription_count():
            self._status_publisher.publish(self.status_message(*self.status()))

    def _publish_plan(self) -> None:
        body = self.motions.whole_body
        if not body.idle and self._plan_publisher.get_subscription_count():
            self._plan_publisher.publish(body.plan_message())

    def begin_shutdown(self, reason: str) -> None:
        """Bring the robot to rest on its path, and accept nothing new."""
        self.motions.begin_shutdown()

    @property
    def finished(self) -> bool:
        """Whether no motion is under way, and all action clients have their results."""
        return self.motions.time_base.idle and all(action.idle for action in self.actions)

    @property
    def stop_timeout(self) -> float:
        """How long the robot may take to come to rest from now on [s], with a margin of 1 s."""
        return 1.0 + self.motions.time_base.remaining()

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for `body/status` and the diagnostics."""
        motions, time_base = self.motions, self.motions.time_base
        body, tool = motions.whole_body, motions.tool
        waits = body.waiting_reason()
        values: list[tuple[str, object]] = [
            ("body", body.core.state.value),
            ("body_progress", round(body.core.progress(time_base.now()), 4)),
            ("waits", waits),
            *status_values(None if body.idle else body.obstruction),
            ("cycle_ms", round(1e3 * body.cycle_time, 2)),
            ("obstacles", len(motions.surroundings.obstacles)),
            ("speed_scaling", round(motions.scaling.value, 4)),
            ("body_event", body.log.event.value),
            ("body_last", body.log.text),
            ("tool_path_event", tool.log.event.value),
            ("tool_path_last", tool.log.text),
        ]
        if waits:
            return DiagnosticStatus.WARN, f"waits: {waits}", values
        latest = max((body.log, tool.log), key=lambda log: log.order)
        if latest.is_trouble and body.idle:
            return DiagnosticStatus.WARN, latest.text, values
        return DiagnosticStatus.OK, time_base.state.value, values


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros whole_body_planner`."""
    return run(WholeBodyPlannerNode, args, PLANNING)
