"""A robot as one object: everything that its file says, validated, ready for the cores."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Self

from omniman_ros.collision.parameters import LoadShape, ToolShape
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import TwistLimits
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.twist_polytope import TwistPolytope
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform, Wheels
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.path.joint_parameters import JointTrajectoryOptions
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.nodes.registry import unknown_names
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.planning.whole_body.parameters import (
    AvoidanceOptions,
    BodySetup,
    OrientationFreedom,
    led_tool,
)
from omniman_ros.robots import robot_parameters
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.world.parameters import WorldParameters
from omniman_ros.simulation.world.scanner_parameters import ScannerParameters


@dataclass(frozen=True, kw_only=True)
class RobotModel:
    """Parameters of a robot, a set for each core; made by :meth:`of` or :func:`load_robot`."""

    name: str  #: Name of a file in config/ without its suffix, or its path
    values: Mapping[str, Any]  #: What was given: full parameter names to values; read-only
    platform: Platform  #: Wheels, body, motors, friction, and the arm as a body at rest
    controller: PlatformParameters  #: For `PlatformController`, its odometry and its coupling
    paths: PathParameters  #: For `PathInterpolator` and its `planner()`
    joint_paths: JointTrajectoryOptions  #: For `JointInterpolator`
    tool_paths: ToolPathOptions  #: For `ToolPlanner`
    planner: PlannerParameters  #: For `Planner`
    avoidance: AvoidanceOptions  #: For `WholeBodyTask`, in `whole_body_setup`
    orientation: OrientationFreedom  #: The same
    tool: ToolShape  #: Shape of the tool at the flange
    load: LoadShape  #: Shape of what lies on the platform
    description: DescriptionParameters  #: Shape of the robot, and its URDF
    simulation: SimulationParameters  #: For `SimulatedDrives`
    world: WorldParameters  #: For `World`
    scanner: ScannerParameters  #: For `Scanner`, the first one

    @classmethod
    def of(cls, name: str, values: Mapping[str, Any]) -> Self:
        """Build all parameter sets from full names and values, such as a robot's file gives.

        Raises:
            ParameterError: A value is refused, one that has no default is missing, or no node of
                the package has a parameter of that name.
            GeometryError: The wheels do not make an omnidirectional platform.
        """
        for unknown, value in values.items():
            for sentence in unknown_names([unknown]):
                raise ParameterError(unknown, value, sentence)
        model = cls(
            name=name,
            values=MappingProxyType(dict(values)),
            platform=build(Platform, values),
            controller=build(PlatformParameters, values),
            paths=build(PathParameters, values),
            joint_paths=build(JointTrajectoryOptions, values, "joint_trajectory."),
            tool_paths=build(ToolPathOptions, values, "tool_path."),
            planner=build(PlannerParameters, values),
            avoidance=build(AvoidanceOptions, values, "dodge."),
            orientation=build(OrientationFreedom, values, "orientation."),
            tool=build(ToolShape, values, "tool."),
            load=build(LoadShape, values, "load."),
            description=build(DescriptionParameters, values),
            simulation=build(SimulationParameters, values),
            world=build(WorldParameters, values, "world."),
            scanner=build(ScannerParameters, values, "scanners."),
        )
        _ = model.kinematics  # raises unless the wheels make a platform
        return model

    def changed(self, values: Mapping[str, Any]) -> Self:
        """Return the same robot with other values of some parameters, by their full names.

        Raises:
            ParameterError, GeometryError: As for :meth:`of`.
        """
        return type(self).of(self.name, {**self.values, **values})

    @property
    def wheels(self) -> Wheels:
        """Positions, directions and radii of the n wheels."""
        return self.platform.wheels

    @property
    def limits(self) -> TwistLimits:
        """Limits of the platform's twist."""
        return self.controller.limits

    @property
    def arm(self) -> ArmParameters:
        """Names and limits of the arm's joints; of use where the robot carries an arm."""
        return self.description.arm

    @cached_property
    def kinematics(self) -> PlatformKinematics:
        """Kinematics of the wheels, CCTA 2017 (2) to (14)."""
        return PlatformKinematics(self.wheels)

    @cached_property
    def reachable_twists(self) -> TwistPolytope:
        """Twists at which no wheel exceeds its largest speed."""
        return TwistPolytope(self.kinematics, self.platform.motor.max_speed)

    @cached_property
    def whole_body(self) -> WholeBodyModel:
        """Kinematics of platform and arm together."""
        return WholeBodyModel(self.description.mount)

    @cached_property
    def whole_body_limits(self) -> WholeBodyLimits:
        """Limits of the nine axes of platform and arm, and of the wheels."""
        return WholeBodyLimits.of_whole_body(self.paths, self.arm)

    @cached_property
    def whole_body_setup(self) -> BodySetup:
        """What a `WholeBodyTask` needs to know of the robot."""
        return BodySetup(
            self.description,
            self.whole_body_limits,
            self.tool,
            self.load if self.load.is_carried else None,
            led_tool(self.tool_paths),
            self.avoidance,
            self.orientation,
        )


def load_robot(robot: str = "omniman") -> RobotModel:
    """Read and validate a robot's file.

    Args:
        robot: Name of a file in config/ without its suffix, or the path of a YAML file.

    Raises:
        ParameterError: There is no such file, it is not a ROS parameter file for all nodes, or a
            name or a value in it is refused.
        GeometryError: The wheels do not make an omnidirectional platform.
    """
    return RobotModel.of(robot, robot_parameters(robot))
