"""Node `whole_body_planner`: the tool on its path while platform and arm avoid obstacles."""

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.extras import PLANNING
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import MotionServices
from omniman_ros.nodes.whole_body_interfaces.body_coordinator import BodyCoordinator
from omniman_ros.nodes.whole_body_interfaces.parameters import WholeBodyPlannerParameters
from omniman_ros.planning.whole_body.obstruction import status_values


class WholeBodyPlannerNode(OmnimanNode):
    """Serves paths and holds of the tool among obstacles as a ROS node."""

    lookahead = 0.04  # about the time that a plan takes

    def __init__(self, **options: object) -> None:
        # Imported here, so that the parameters of this module can be read without casadi.
        from omniman_ros.planning.whole_body.controller import PERIOD

        super().__init__("whole_body_planner", **options)
        self.settings = ParameterSet(self, WholeBodyPlannerParameters)
        self.motions = BodyCoordinator(self, self.settings, PERIOD)
        self.settings.on_change(self.motions.configure)
        time_base = self.motions.context.time_base
        services = MotionServices(self, time_base, self.motions.cancel, self.motions.send)
        services.add("hold", self.motions.hold, lambda: self.motions.tool.log.text)
        self._status_publisher = self.create_publisher(DiagnosticStatus, "body/status", 10)
        self.every(PERIOD, self._tick)

    def _tick(self) -> None:
        self.motions.tick()
        if self._status_publisher.get_subscription_count():
            self._status_publisher.publish(self.status_message(*self.status()))

    def begin_shutdown(self, reason: str) -> None:
        """Bring the robot to rest on its path, and accept nothing new."""
        self.motions.begin_shutdown()

    @property
    def finished(self) -> bool:
        """Whether no motion is under way."""
        return self.motions.context.time_base.idle

    @property
    def stop_timeout(self) -> float:
        """How long the robot may take to come to rest from now on [s], with a margin of 1 s."""
        return 1.0 + self.motions.context.time_base.remaining()

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for `body/status` and the diagnostics."""
        motions, time_base = self.motions, self.motions.context.time_base
        body, tool = motions.whole_body, motions.tool
        waits = body.waiting_reason()
        values: list[tuple[str, object]] = [
            ("body", body.core.state.value),
            ("body_progress", round(body.core.progress(time_base.now()), 4)),
            ("waits", waits),
            *status_values(None if body.idle else body.obstruction),
            ("cycle_ms", round(1e3 * body.cycle_time, 2)),
            ("obstacles", len(motions.surroundings)),
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
