"""Parameters of the node `mpc_planner`."""

import math
from dataclasses import dataclass

from omniman_ros.collision.body_outline import BodyOutline
from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import inline, parameter
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.nodes.frame_parameters import FrameParameters
from omniman_ros.nodes.preview_parameters import RestartParameters
from omniman_ros.nodes.surroundings_parameters import MapReading
from omniman_ros.planning.parameters import PlannerParameters


@dataclass(frozen=True, kw_only=True)
class FootprintOptions(Validated):
    """Posture of the arm in the footprint, and heights of obstacles."""

    posture: tuple[float, ...] = parameter(
        (math.pi, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0),
        "Joint angles that are assumed until arm/joint_states are received; by default the arm is "
        "folded backwards, above the deck of `omniman`.",
        unit="rad",
        low=-math.tau,
        high=math.tau,
    )
    required: bool = parameter(
        False,
        "Whether the robot waits for arm/joint_states before it moves, and stops if they end.",
    )
    states_timeout: float = parameter(
        0.5,
        "Age of arm/joint_states from which on they count as silent; the last posture is kept.",
        unit="s",
        low=0.02,
        high=60,
    )
    height_margin: float = parameter(
        0.05,
        "Vertical gap up to which an obstacle counts as being at the height of a part of the "
        "robot.",
        unit="m",
        low=0,
        high=1,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.posture) != JOINTS:
            raise self._refusal("posture", f"must have {JOINTS} angles")


@dataclass(frozen=True, kw_only=True)
class ComputationOptions(Validated):
    """How plans are computed."""

    compile: str = parameter(
        "auto",
        "Whether the planner's functions are compiled in the background where there is a C "
        "compiler, and kept in ~/.cache/omniman_ros.",
        choices=("auto", "never"),
        read_only=True,
    )


@dataclass(frozen=True, kw_only=True)
class MpcPlannerParameters(RestartParameters):
    """Parameters of the planner, of the streams, and of frames and maps."""

    core: PlannerParameters = inline()
    arm: ArmParameters
    mount: Mount
    tool: ToolShape
    load: LoadShape
    footprint: FootprintOptions
    planner: ComputationOptions
    output: str = parameter(
        "reference",
        "What drives the robot: `mpc/reference`, which the platform controller "
        "follows, or `mpc/voltages`. Only at rest.",
        choices=("reference", "voltages"),
    )
    period: float = parameter(
        0.05, "Period of the planning.", unit="s", low=0.01, high=1, read_only=True
    )
    voltages_period: float = parameter(
        0.01, "Period of the voltages.", unit="s", low=0.005, high=0.05, read_only=True
    )
    odom_timeout: float = parameter(
        0.3,
        "Age at which odom is too old to drive by: the goal is given up.",
        unit="s",
        low=0.02,
        high=10,
    )
    frames: FrameParameters = inline()
    navigate_action: str = parameter(
        "navigate_to_pose", "Name of the action that takes goals.", read_only=True
    )
    map_reading: MapReading = inline()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.core.safety.deadline > self.period:
            raise ParameterError(
                "safety.deadline",
                self.core.safety.deadline,
                f"must be <= the period {self.period:g} s",
            )


def body_outline(parameters: MpcPlannerParameters) -> BodyOutline:
    """Return the outline of the robot with arm, tool and load."""
    p = parameters
    description = DescriptionParameters(robot=p.core.robot, arm=p.arm, mount=p.mount)
    return BodyOutline(description, p.tool, p.load)
