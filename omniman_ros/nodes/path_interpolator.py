"""Node `path_interpolator`: paths and trajectories in, streams for platform and arm out."""

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.nodes.navigation_action import (
    NavigationAction,
    NavigationKind,
    serve_navigation,
)
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.trajectory_interfaces.motion_coordinator import MotionCoordinator
from omniman_ros.nodes.trajectory_interfaces.motion_time_base import MotionServices
from omniman_ros.nodes.trajectory_interfaces.parameters import PathInterpolatorParameters
from omniman_ros.nodes.trajectory_interfaces.trajectory_action import (
    TrajectoryAction,
    serve_actions,
)


class PathInterpolatorNode(OmnimanNode):
    """Serves the motions of platform, arm and whole body as a ROS node."""

    def __init__(self, **options: object) -> None:
        super().__init__("path_interpolator", **options)
        self.settings = ParameterSet(self, PathInterpolatorParameters)
        p = self.settings.value
        self.motions = MotionCoordinator(self, self.settings)
        served = {p.arm_action: self.motions.arm, p.body_action: self.motions.whole_body}
        self._trajectory_actions = serve_actions(self, served, p.trajectory_action)
        self.actions: tuple[TrajectoryAction | NavigationAction, ...] = (
            *self._trajectory_actions,
            *serve_navigation(self, NavigationKind.FOLLOW_PATH, p.path_action, self.motions.path),
        )
        self.settings.on_change(self._configure)
        time_base = self.motions.context.time_base
        MotionServices(self, time_base, self.motions.cancel, self.motions.tick)
        self.every(p.period, self.motions.tick)

    def _configure(self, new: PathInterpolatorParameters) -> None:
        self.motions.configure(new)
        for action in self._trajectory_actions:
            action.options = new.trajectory_action

    def begin_shutdown(self, reason: str) -> None:
        """Bring all motions to rest on their paths, and accept nothing new."""
        self.motions.begin_shutdown()

    @property
    def finished(self) -> bool:
        """Whether no motion is under way, and all action clients have their results."""
        return self.motions.context.time_base.idle and all(action.idle for action in self.actions)

    @property
    def stop_timeout(self) -> float:
        """How long the motions may take to come to rest from now on [s], with a margin of 1 s."""
        remaining = self.motions.context.time_base.remaining()
        return 1.0 + remaining + self.settings.value.core.path.settle

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values of the diagnostics."""
        motions, time_base = self.motions, self.motions.context.time_base
        now, path = time_base.now(), motions.path
        values: list[tuple[str, object]] = [
            ("state", path.core.state.value),
            ("path_progress", round(path.core.progress(now), 4)),
            ("remaining_s", round(path.core.remaining(now), 2)),
        ]
        for name, interface in (("arm", motions.arm), ("body", motions.whole_body)):
            values += [
                (name, interface.core.state.value),
                (f"{name}_progress", round(interface.core.progress(now), 4)),
                (f"{name}_event", interface.log.event.value),
                (f"{name}_last", interface.log.text),
            ]
        if motions.tool is not None:
            values += [
                ("tool_path_event", motions.tool.log.event.value),
                ("tool_path_last", motions.tool.log.text),
            ]
        values += [
            ("speed_scaling", round(motions.scaling.value, 4)),
            ("event", path.log.event.value),
            ("last", path.log.text),
        ]
        takers = [it for it in (path, motions.arm, motions.whole_body, motions.tool) if it]
        latest = max(takers, key=lambda interface: interface.log.order)
        if latest.log.is_trouble and latest.idle:
            return DiagnosticStatus.WARN, latest.log.text, values
        return DiagnosticStatus.OK, time_base.state.value, values


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros path_interpolator`."""
    return run(PathInterpolatorNode, args)
