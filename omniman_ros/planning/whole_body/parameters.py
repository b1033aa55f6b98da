"""Parameters of the motion of the whole body around obstacles."""

from dataclasses import dataclass, field, replace

from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_curve import ROTATION_LENGTH


@dataclass(frozen=True)
class PathSearchOptions(Validated):
    """Options of the search for the platform's way."""

    layer: float = parameter(
        0.1, "Distance between layers along the tool's path.", unit="m", low=0.02, high=0.5
    )
    grid: float = parameter(
        0.1, "Distance between the platform's positions.", unit="m", low=0.02, high=0.5
    )
    headings: int = parameter(24, "Number of headings of the platform.", low=8, high=72)
    margin: float = parameter(
        0.06, "Gap that the way keeps to what stands.", unit="m", low=0.0, high=1.0
    )
    wide: float = parameter(
        0.25, "Gap from which on a wider one is no better.", unit="m", low=0.0, high=2.0
    )
    spacing: float = parameter(
        0.15, "Spacing of the spheres that stand for the arm.", unit="m", low=0.02, high=0.5
    )
    shape: float = parameter(1.0, "Weight of the arm's shape, per layer.", low=0.0, high=1e3)
    narrow: float = parameter(
        4.0, "Weight of narrow gaps, per layer and square of the share.", low=0.0, high=1e4
    )
    travel: float = parameter(
        20.0, "Weight of the platform's travel.", unit="1/m^2", low=0.0, high=1e4
    )
    turn: float = parameter(
        6.0, "Weight of the platform's rotation.", unit="1/rad^2", low=0.0, high=1e4
    )


@dataclass(frozen=True)
class AvoidanceOptions(Validated):
    """Options of the control of the whole body in its redundancy."""

    way: PathSearchOptions
    steps: int = parameter(25, "Steps N of the horizon.", low=5, high=60)
    step: float = parameter(
        0.1, "Time over which accelerations are held.", unit="s", low=0.02, high=0.5
    )
    gaps: int = parameter(16, "Number of gaps at each node of the program.", low=4, high=60)
    spacing: float = parameter(
        0.08, "Spacing of the spheres that stand for the arm.", unit="m", low=0.02, high=0.5
    )
    clearance: float = parameter(
        0.06, "Gap that plans keep to what stands.", unit="m", low=0.0, high=1.0
    )
    moving_clearance: float = parameter(
        0.1, "Gap that plans keep to what moves, before its growth.", unit="m", low=0.0, high=1.0
    )
    joint_effort: float = parameter(
        0.35,
        "Fraction of the limits on speed and acceleration of joints that plans use where there is "
        "room: a servo follows slow joints more exactly.",
        low=0.1,
        high=1.0,
    )
    time_gap: float = parameter(
        0.2,
        "Time in which what moves covers the gap that plans keep to it besides: people turn.",
        unit="s",
        low=0.0,
        high=5.0,
    )
    least_clearance: float = parameter(
        0.04,
        "Gap below which a plan is not followed: above the margin of `collision_monitor`, which "
        "would hold the robot there.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    own_clearance: float = parameter(
        0.01,
        "Gap between parts of the robot below which a plan is not followed.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    tip_over_margin: float = parameter(
        0.05,
        "Tip-over margin below which a plan is not followed: distance of the zero moment point "
        "from the border of the wheels' contacts. A posture that has less at rest may use half.",
        unit="m",
        low=0.0,
        high=1.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.least_clearance > self.clearance:
            raise self._refusal("least_clearance", "must not be above clearance")


@dataclass(frozen=True)
class OrientationFreedom(Validated):
    """What paths of the tool leave free of its orientation; its position is held."""

    free_axis: str = parameter(
        "none",
        "Axis of `tool0` about which the tool may rotate on its paths; none: its orientation is "
        "held.",
        choices=("none", "x", "y", "z"),
    )
    cone: float = parameter(
        0.0,
        "Half angle of the cone in which that axis may tilt; 0: it is held.",
        unit="rad",
        low=0.0,
        high=1.5,
    )
    pivot: float = parameter(
        0.0,
        "Distance from `tool0`, along that axis, of the point that is held while it tilts, such "
        "as the tip of the tool.",
        unit="m",
        low=-2.0,
        high=2.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cone > 0.0 and not self.is_free:
            raise self._refusal("cone", "needs a free_axis")

    @property
    def is_free(self) -> bool:
        """Whether there is a free axis."""
        return self.free_axis != "none"


@dataclass(frozen=True)
class BodySetup(Validated):
    """What a task needs to know of the robot."""

    description: DescriptionParameters  #: Shapes of platform and arm, and where the arm is mounted
    limits: WholeBodyLimits  #: Limits of the nine axes and of the wheels
    tool: ToolShape
    load: LoadShape | None  #: Shape of the load, if any
    path: ToolPathOptions  #: Options of tool paths
    dodge: AvoidanceOptions  #: Options of the way around obstacles
    #: What is free of the tool's orientation on its paths
    freedom: OrientationFreedom = field(default_factory=OrientationFreedom)


def led_tool(options: ToolPathOptions) -> ToolPathOptions:
    """Return options of a path whose one parameter keeps the linear and the angular limits."""
    o = options
    speed = min(o.linear_velocity, ROTATION_LENGTH * o.angular_velocity)
    acceleration = min(o.linear_acceleration, ROTATION_LENGTH * o.angular_acceleration)
    return replace(o, linear_velocity=speed, linear_acceleration=acceleration)
