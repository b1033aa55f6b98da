"""Parameters of the node `viewer`."""

from dataclasses import dataclass, replace

from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.parameters import REQUIRED, inline, parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.nodes.obstacle_tracker_parameters import ScannerInput
from omniman_ros.viewer.body_view import BodyShapes
from omniman_ros.viewer.page_access import PageAccess


@dataclass(frozen=True)
class DrivingLimits(Validated):
    """Bounds of the speed sliders; the platform controller enforces the robot's limits."""

    linear_velocity: float = parameter(
        REQUIRED,
        "Largest linear speed of the buttons.",
        unit="m/s",
        low=1e-3,
        high=20,
        read_only=True,
    )
    angular_velocity: float = parameter(
        REQUIRED,
        "Largest yaw rate of the buttons.",
        unit="rad/s",
        low=1e-3,
        high=50,
        read_only=True,
    )


@dataclass(frozen=True, kw_only=True)
class ViewerParameters(Validated):
    """Parameters of the viewer: robot to draw, address of the page, frame rate and frames."""

    robot: Platform = inline()
    arm: ArmParameters
    mount: Mount
    limits: DrivingLimits
    access: PageAccess = inline()
    tool: ToolShape
    load: LoadShape
    scanners: tuple[ScannerInput, ...]
    scanners_by_tf: bool = parameter(
        True,
        "Whether TF has the poses of the scanners; if not, scanners.x, y, z and yaw have them.",
        read_only=True,
    )
    frame_rate: float = parameter(
        25.0,
        "Frame rate of the page while a browser is connected.",
        unit="Hz",
        low=1,
        high=60,
        read_only=True,
    )
    odom_frame: str = parameter("odom", "Frame of paths, references and goals.", read_only=True)
    map_is_odom: bool = parameter(
        False,
        "Whether paths, goals and obstacles in `map` are treated as in odom.",
        read_only=True,
    )
    base_frame: str = parameter("base_link", "Frame of twists.", read_only=True)
    cmd_vel_stamped: bool = parameter(False, "Whether cmd_vel is a TwistStamped.", read_only=True)

    def shapes(self, *, with_arm: bool) -> BodyShapes:
        """Return the shapes of the robot, with or without the arm that it has."""
        arm = self.robot.arm if with_arm else replace(self.robot.arm, mass=0.0)
        robot = replace(self.robot, arm=arm)
        description = DescriptionParameters(robot=robot, arm=self.arm, mount=self.mount)
        return BodyShapes(description, self.tool, self.load)

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of the frames that are treated as `odom`, that of the goals first."""
        return (self.odom_frame, "map") if self.map_is_odom else (self.odom_frame,)
