"""Motion control of a mobile manipulator on Mecanum or Omni wheels.

    import omniman_ros as om

    robot = om.load_robot("omniman")            # everything that config/omniman.yaml says
    kinematics = om.PlatformKinematics(robot.wheels)
    wheel_speeds = kinematics.J @ [0.3, 0.0, 0.2]

    with om.simulated_robot("omniman") as running:    # or om.Robot(), for one that runs already
        running.go_to(2.0, 1.0, 1.57).wait()

The public names, each imported when it is first used:

* The robot: `load_robot`, `RobotModel`; `Platform` of `Wheels`, `Body`, `Arm`, `Motor` and
  `Friction`; `TwistLimits`.
* Control, CCTA 2017: `PlatformKinematics`, `TwistPolytope`, `PlatformDynamics`, `Odometry` with
  `OdometryParameters`, `CouplingController` with `CouplingParameters`; `PlatformController`, which
  is all of it, `Source`, `WheelCommand` and `DriveMode`.
* Motions along given paths: `PathInterpolator`; `JointInterpolator`, `JointPlanner` and
  `AxisLimits`; `ToolPlanner`; `ArmModel`, `WholeBodyModel`; `Preview` and `HermiteTrajectory`.
* Planning among obstacles, MPC 2021 and beyond: `Planner` with `MeasuredState`, `PoseGoal`,
  `StateGoal`, `TrajectoryGoal`, `Ellipses` and `GridMap`; `WholeBodyTask`,
  `tool_goal_task` and `JointGoalTask` with `ObstacleSnapshot`, `MovingObstacles`,
  `UprightObstacles` and `OrientationFreedom`. Need casadi.
* Simulation: `SimulatedDrives` on a plant, or in a `World` of physics, which needs mujoco-core,
  with a `Scene` of `Wall`, `Post`, `Table` and `Person`, or one by `load_scene`, and a `Scanner`.
* Drives on a CAN bus: `CanDrives` by `CanParameters`; `DriveAxis` with `AxisState`, `Demand` and
  `CanFrame`, for a protocol of your own; `SimulatedBus`, drives for a master of your own. Need
  python-can and canopen.
* Recordings: `read_recording` and `write_recording` of a `RobotLog`. Need rosbags.
* A running robot: `Robot`, or `simulated_robot`, which starts one; `MotionHandle` with `Outcome`,
  `MotionResult`, `MotionFeedback` and `MotionError`; `Reading`; `RobotError`, `RobotTimeoutError`
  and `NodesRefusedError`. Need ROS 2.
* Errors: `OmnimanError` and its kinds `ParameterError`, `GeometryError`, `InputError`.

Time is an argument of the cores, SI units and radians hold everywhere, x is forward and y left.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omniman_ros.can_drives.axis import AxisState as AxisState
    from omniman_ros.can_drives.axis import Demand as Demand
    from omniman_ros.can_drives.axis import DriveAxis as DriveAxis
    from omniman_ros.can_drives.drives import CanDrives as CanDrives
    from omniman_ros.can_drives.frame import CanFrame as CanFrame
    from omniman_ros.client.handle import MotionError as MotionError
    from omniman_ros.client.handle import MotionFeedback as MotionFeedback
    from omniman_ros.client.handle import MotionHandle as MotionHandle
    from omniman_ros.client.handle import MotionResult as MotionResult
    from omniman_ros.client.handle import Outcome as Outcome
    from omniman_ros.client.robot import Robot as Robot
    from omniman_ros.client.simulated import simulated_robot as simulated_robot
    from omniman_ros.client.state import NodesRefusedError as NodesRefusedError
    from omniman_ros.client.state import Reading as Reading
    from omniman_ros.client.state import RobotError as RobotError
    from omniman_ros.client.state import RobotTimeoutError as RobotTimeoutError
    from omniman_ros.collision.moving_obstacles import MovingObstacles as MovingObstacles
    from omniman_ros.collision.upright_obstacles import UprightObstacles as UprightObstacles
    from omniman_ros.control.coupling_controller import CouplingController as CouplingController
    from omniman_ros.control.coupling_controller import CouplingParameters as CouplingParameters
    from omniman_ros.control.dynamics import PlatformDynamics as PlatformDynamics
    from omniman_ros.control.kinematics import PlatformKinematics as PlatformKinematics
    from omniman_ros.control.limits import TwistLimits as TwistLimits
    from omniman_ros.control.odometry import Odometry as Odometry
    from omniman_ros.control.odometry import OdometryParameters as OdometryParameters
    from omniman_ros.control.platform import PlatformController as PlatformController
    from omniman_ros.control.twist_polytope import TwistPolytope as TwistPolytope
    from omniman_ros.control.wheel_cascade import DriveMode as DriveMode
    from omniman_ros.control.wheel_cascade import WheelCommand as WheelCommand
    from omniman_ros.core.arbiter import Source as Source
    from omniman_ros.core.arm_model import ArmModel as ArmModel
    from omniman_ros.core.can_parameters import CanParameters as CanParameters
    from omniman_ros.core.errors import GeometryError as GeometryError
    from omniman_ros.core.errors import InputError as InputError
    from omniman_ros.core.errors import OmnimanError as OmnimanError
    from omniman_ros.core.errors import ParameterError as ParameterError
    from omniman_ros.core.platform import Arm as Arm
    from omniman_ros.core.platform import Body as Body
    from omniman_ros.core.platform import Friction as Friction
    from omniman_ros.core.platform import Motor as Motor
    from omniman_ros.core.platform import Platform as Platform
    from omniman_ros.core.platform import Wheels as Wheels
    from omniman_ros.core.preview import Preview as Preview
    from omniman_ros.motion.path.axis_limits import AxisLimits as AxisLimits
    from omniman_ros.motion.path.interpolator import PathInterpolator as PathInterpolator
    from omniman_ros.motion.path.joint_interpolator import JointInterpolator as JointInterpolator
    from omniman_ros.motion.path.joint_points import JointPlanner as JointPlanner
    from omniman_ros.motion.whole_body.model import WholeBodyModel as WholeBodyModel
    from omniman_ros.motion.whole_body.tool_planner import ToolPlanner as ToolPlanner
    from omniman_ros.planning.cycle import MeasuredState as MeasuredState
    from omniman_ros.planning.goals import PoseGoal as PoseGoal
    from omniman_ros.planning.goals import StateGoal as StateGoal
    from omniman_ros.planning.goals import TrajectoryGoal as TrajectoryGoal
    from omniman_ros.planning.motion import HermiteTrajectory as HermiteTrajectory
    from omniman_ros.planning.planner import Planner as Planner
    from omniman_ros.planning.whole_body.joint_goal import JointGoalTask as JointGoalTask
    from omniman_ros.planning.whole_body.obstacle_snapshot import (
        ObstacleSnapshot as ObstacleSnapshot,
    )
    from omniman_ros.planning.whole_body.parameters import (
        OrientationFreedom as OrientationFreedom,
    )
    from omniman_ros.planning.whole_body.task import WholeBodyTask as WholeBodyTask
    from omniman_ros.planning.whole_body.tool_goal import tool_goal_task as tool_goal_task
    from omniman_ros.recording.recordings import read_recording as read_recording
    from omniman_ros.recording.recordings import write_recording as write_recording
    from omniman_ros.recording.robot_log import RobotLog as RobotLog
    from omniman_ros.robot_model import RobotModel as RobotModel
    from omniman_ros.robot_model import load_robot as load_robot
    from omniman_ros.simulation.can_drives.network import SimulatedBus as SimulatedBus
    from omniman_ros.simulation.plant.simulated_drives import SimulatedDrives as SimulatedDrives
    from omniman_ros.simulation.scene_files import load_scene as load_scene
    from omniman_ros.simulation.world.scanner import Scanner as Scanner
    from omniman_ros.simulation.world.scene import Person as Person
    from omniman_ros.simulation.world.scene import Post as Post
    from omniman_ros.simulation.world.scene import Scene as Scene
    from omniman_ros.simulation.world.scene import Table as Table
    from omniman_ros.simulation.world.scene import Wall as Wall
    from omniman_ros.simulation.world.world import World as World
    from omniman_ros.surroundings.ellipses import Ellipses as Ellipses
    from omniman_ros.surroundings.grid_map import GridMap as GridMap

#: Modules of the public names, within the package; the imports above are for type checkers
_PUBLIC = {
    "can_drives.axis": ("AxisState", "Demand", "DriveAxis"),
    "can_drives.drives": ("CanDrives",),
    "can_drives.frame": ("CanFrame",),
    "client.handle": ("MotionError", "MotionFeedback", "MotionHandle", "MotionResult", "Outcome"),
    "client.robot": ("Robot",),
    "client.simulated": ("simulated_robot",),
    "client.state": ("NodesRefusedError", "Reading", "RobotError", "RobotTimeoutError"),
    "collision.moving_obstacles": ("MovingObstacles",),
    "collision.upright_obstacles": ("UprightObstacles",),
    "control.coupling_controller": ("CouplingController", "CouplingParameters"),
    "control.dynamics": ("PlatformDynamics",),
    "control.kinematics": ("PlatformKinematics",),
    "control.limits": ("TwistLimits",),
    "control.odometry": ("Odometry", "OdometryParameters"),
    "control.platform": ("PlatformController",),
    "control.twist_polytope": ("TwistPolytope",),
    "control.wheel_cascade": ("DriveMode", "WheelCommand"),
    "core.arbiter": ("Source",),
    "core.arm_model": ("ArmModel",),
    "core.can_parameters": ("CanParameters",),
    "core.errors": ("GeometryError", "InputError", "OmnimanError", "ParameterError"),
    "core.platform": ("Arm", "Body", "Friction", "Motor", "Platform", "Wheels"),
    "core.preview": ("Preview",),
    "motion.path.axis_limits": ("AxisLimits",),
    "motion.path.interpolator": ("PathInterpolator",),
    "motion.path.joint_interpolator": ("JointInterpolator",),
    "motion.path.joint_points": ("JointPlanner",),
    "motion.whole_body.model": ("WholeBodyModel",),
    "motion.whole_body.tool_planner": ("ToolPlanner",),
    "planning.cycle": ("MeasuredState",),
    "planning.goals": ("PoseGoal", "StateGoal", "TrajectoryGoal"),
    "planning.motion": ("HermiteTrajectory",),
    "surroundings.ellipses": ("Ellipses",),
    "surroundings.grid_map": ("GridMap",),
    "planning.planner": ("Planner",),
    "planning.whole_body.joint_goal": ("JointGoalTask",),
    "planning.whole_body.obstacle_snapshot": ("ObstacleSnapshot",),
    "planning.whole_body.parameters": ("OrientationFreedom",),
    "planning.whole_body.task": ("WholeBodyTask",),
    "planning.whole_body.tool_goal": ("tool_goal_task",),
    "recording.recordings": ("read_recording", "write_recording"),
    "recording.robot_log": ("RobotLog",),
    "robot_model": ("RobotModel", "load_robot"),
    "simulation.can_drives.network": ("SimulatedBus",),
    "simulation.plant.simulated_drives": ("SimulatedDrives",),
    "simulation.scene_files": ("load_scene",),
    "simulation.world.scanner": ("Scanner",),
    "simulation.world.scene": ("Person", "Post", "Scene", "Table", "Wall"),
    "simulation.world.world": ("World",),
}
_MODULES = {name: module for module, names in _PUBLIC.items() for name in names}
#: Names whose modules need an optional library, by the name of it in `extras`
_OF_EXTRAS = {
    "CanDrives": "CAN",
    "JointGoalTask": "PLANNING",
    "Planner": "PLANNING",
    "RobotLog": "RECORDING",
    "SimulatedBus": "CAN",
    "WholeBodyTask": "PLANNING",
    "World": "WORLD",
    "read_recording": "RECORDING",
    "tool_goal_task": "PLANNING",
    "write_recording": "RECORDING",
}

__all__ = sorted(_MODULES)  # noqa: PLE0605, RUF100  (computed: the table is the one list)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'omniman_ros' has no attribute '{name}'")
    if name in _OF_EXTRAS and not (extra := _extra(name)).is_available:
        raise ModuleNotFoundError(f"om.{name}: {extra.hint}")
    value = getattr(importlib.import_module(f"omniman_ros.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names that can be used here: without those of libraries that are missing."""
    return [name for name in __all__ if name not in _OF_EXTRAS or _extra(name).is_available]


def _extra(name: str) -> Any:
    return getattr(importlib.import_module("omniman_ros.extras"), _OF_EXTRAS[name])
