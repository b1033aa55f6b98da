"""Parameters of MoveIt for a robot with an arm: what a MoveIt configuration package contains."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.validated import Validated
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.description.urdf import carries_arm
from omniman_ros.motion.axes import PLANAR_VARIABLES
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.moveit.link_pairs import unchecked_pairs
from omniman_ros.moveit.srdf import ARM, WHOLE_BODY, srdf

ARM_CONTROLLER, BODY_CONTROLLER = "arm_controller", "body_controller"
"""Controllers whose action `follow_joint_trajectory` path_interpolator serves."""
SOLVER_TIMEOUT = 0.05  #: Time for the inverse kinematics of a pose [s]


@dataclass(frozen=True)
class MoveItConfiguration(Validated):
    """What move_group needs to know of a robot.

    Raises:
        ParameterError: The robot has no arm.
    """

    description: DescriptionParameters  #: The robot
    path: PathParameters  #: Limits of the platform on paths, which `path_interpolator` holds

    def __post_init__(self) -> None:
        super().__post_init__()
        if not carries_arm(self.description.robot):
            raise ParameterError("arm.mass", self.description.robot.arm.mass, "must be above 0")

    @cached_property
    def srdf(self) -> str:
        """Groups, planar joint, and pairs of links that are not checked."""
        return srdf(self.description, unchecked_pairs(self.description))

    @property
    def kinematics(self) -> dict[str, Any]:
        """Solvers of the groups' inverse kinematics."""
        solver = {
            "kinematics_solver": "kdl_kinematics_plugin/KDLKinematicsPlugin",
            "kinematics_solver_search_resolution": 0.005,
            "kinematics_solver_timeout": SOLVER_TIMEOUT,
        }
        return {ARM: solver}

    @property
    def joint_limits(self) -> dict[str, Any]:
        """Limits of all axes, within those that `path_interpolator` holds.

        MoveIt limits x and y one by one, while the platform's limits are those of the vector, and
        all axes may be at their limits at once, which the wheels have to stand.
        """
        limits = WholeBodyLimits.of_whole_body(self.path, self.description.arm)
        speeds, accelerations = limits.velocity.copy(), limits.acceleration.copy()
        jerks = limits.jerk.copy()
        for array in (speeds, accelerations, jerks):
            array[:2] /= math.sqrt(2.0)
        fastest = float((np.abs(limits.wheels) @ speeds[:3]).max())
        speeds[:3] *= min(1.0, limits.wheel_speed / fastest)
        names = (*PLANAR_VARIABLES, *self.description.arm.joints)
        return {
            "default_velocity_scaling_factor": 0.5,
            "default_acceleration_scaling_factor": 0.5,
            "joint_limits": {
                name: {
                    "has_velocity_limits": True,
                    "max_velocity": float(speeds[i]),
                    "has_acceleration_limits": True,
                    "max_acceleration": float(accelerations[i]),
                    "has_jerk_limits": True,
                    "max_jerk": float(jerks[i]),
                }
                for i, name in enumerate(names)
            },
        }

    @property
    def controllers(self) -> dict[str, Any]:
        """Controllers to which MoveIt sends trajectories: those of the arm and of all axes."""
        arm = list(self.description.arm.joints)
        assert len(arm) == JOINTS
        joints = {ARM_CONTROLLER: arm, BODY_CONTROLLER: [*PLANAR_VARIABLES, *arm]}
        manager = "moveit_simple_controller_manager"
        return {
            "moveit_controller_manager": f"{manager}/MoveItSimpleControllerManager",
            manager: {
                "controller_names": list(joints),
                **{
                    name: {
                        "type": "FollowJointTrajectory",
                        "action_ns": "follow_joint_trajectory",
                        "default": name == ARM_CONTROLLER,
                        "joints": names,
                    }
                    for name, names in joints.items()
                },
            },
            "trajectory_execution": {
                # The platform's variables are sent as joints of body_controller.
                "control_multi_dof_joint_variables": True,
                "allowed_start_tolerance": 0.05,
                # A robot that slows down before an obstacle or on the pendant is not late.
                "execution_duration_monitoring": False,
            },
        }

    @property
    def planning(self) -> dict[str, Any]:
        """Pipeline of planners: OMPL, with times by the limits of speed and acceleration."""
        ompl = {
            "planning_plugins": ["ompl_interface/OMPLPlanner"],
            "request_adapters": [
                f"default_planning_request_adapters/{name}"
                for name in (
                    "ResolveConstraintFrames",
                    "ValidateWorkspaceBounds",
                    "CheckStartStateBounds",
                    "CheckStartStateCollision",
                )
            ],
            "response_adapters": [
                f"default_planning_response_adapters/{name}"
                for name in (
                    "AddTimeOptimalParameterization",
                    "ValidateSolution",
                    "DisplayMotionPath",
                )
            ],
            "planner_configs": {"RRTConnect": {"type": "geometric::RRTConnect", "range": 0.0}},
            ARM: {"planner_configs": ["RRTConnect"]},
            WHOLE_BODY: {"planner_configs": ["RRTConnect"]},
        }
        return {"planning_pipelines": ["ompl"], "default_planning_pipeline": "ompl", "ompl": ompl}

    @property
    def panel(self) -> dict[str, Any]:
        """Parameters that RViz's panel of MoveIt needs."""
        return {
            "robot_description": self.description.urdf,
            "robot_description_semantic": self.srdf,
            "robot_description_kinematics": self.kinematics,
            "robot_description_planning": self.joint_limits,
        }

    @property
    def move_group(self) -> dict[str, Any]:
        """All parameters of the node `move_group`."""
        return {
            **self.panel,
            "publish_robot_description_semantic": True,
            **self.controllers,
            **self.planning,
        }
