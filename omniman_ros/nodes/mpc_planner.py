"""Node `mpc_planner`: goals and obstacles in, a checked motion on `mpc/reference` out."""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.extras import PLANNING
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.motion_log import MotionEvent
from omniman_ros.nodes.navigation_action import NavigationKind, serve_navigation
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.goal_anchor import GoalAnchor
from omniman_ros.nodes.planner_interfaces.goal_interface import GoalExecutor, GoalInterface
from omniman_ros.nodes.planner_interfaces.motion_publisher import MotionPublisher, PlanPublisher
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters
from omniman_ros.nodes.planner_interfaces.planner_loop import PlannerLoop
from omniman_ros.nodes.planner_interfaces.sensor_interface import (
    ArmConfigurationInterface,
    SensorInterface,
)
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stream_monitor_interface import StreamMonitorInterface
from omniman_ros.planning.cycle import PlannerState

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.nodes.planner_interfaces.compiled_functions import CompiledFunctions


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
        self.sensors = SensorInterface(self, self.settings, self.frames, self.core, self._monitor)
        self.posture = ArmConfigurationInterface(self, self.settings)
        self.publisher = MotionPublisher(self, self.settings, self.core, self._monitor)
        plans = PlanPublisher(self, p.frames.odom.odom_frame, self.core)
        anchor = GoalAnchor(self.core, self.frames)
        self.loop = PlannerLoop(
            self,
            self.core,
            anchor,
            self.sensors,
            self.posture,
            self.publisher,
            plans,
            self._monitor,
        )
        self.settings.on_change(self._configure)
        self._status_publisher = self.create_publisher(DiagnosticStatus, "mpc/status", 10)
        goals = GoalInterface(self, self.settings, self.frames, self.loop)
        executor = GoalExecutor(
            self, goals, self.loop, self.sensors, self.core, p.frames.odom.odom_frame
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
        self.sensors.configure(new)
        self._monitor.silence = new.restart

    def _compile(self) -> None:
        """Have the functions of the present solvers compiled in the background."""
        from omniman_ros.nodes.planner_interfaces import compiled_functions

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
        measured, route = self.sensors.measured, core.route_planner
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
            ("obstacles", len(self.sensors.obstacles)),
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
