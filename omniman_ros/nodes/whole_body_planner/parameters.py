"""Parameters of the node `whole_body_planner`."""

from dataclasses import dataclass

from omniman_ros.core.parameters import inline, parameter
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.nodes.path_interpolator.parameters import StreamParameters
from omniman_ros.nodes.surroundings_parameters import SurroundingsParameters
from omniman_ros.planning.whole_body.parameters import (
    AvoidanceOptions,
    OrientationFreedom,
    led_tool,
)


@dataclass(frozen=True, kw_only=True)
class WholeBodyPlannerParameters(StreamParameters):
    """Parameters of the node: those of its core, its surroundings and its streams."""

    dodge: AvoidanceOptions
    orientation: OrientationFreedom
    surroundings: SurroundingsParameters = inline()
    patience: float = parameter(
        30.0,
        "Time without progress on the path after which it is given up.",
        unit="s",
        low=1.0,
        high=3600.0,
    )

    goal_action: str = parameter(
        "~/move_tool", "Name of the action that takes goals of the tool.", read_only=True
    )
    path_action: str = parameter(
        "~/follow_tool_path", "Name of the action that takes paths of the tool.", read_only=True
    )
    joint_action: str = parameter(
        "~/move_body",
        "Name of the action that takes goals of platform and joints.",
        read_only=True,
    )

    @property
    def led_tool(self) -> ToolPathOptions:
        """Options of paths whose one parameter keeps both the linear and the angular limits."""
        return led_tool(self.tool_path)
