"""Conversion and validation of the goals of `follow_joint_trajectory`, and its feedback."""

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.conversions.joints import abbreviate_names
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.path.trajectory_goal import (
    GoalMonitor,
    GoalTolerances,
    TrajectoryActionOptions,
)

#: Fields of a point of a trajectory, in the order of their derivatives
PARTS = ("positions", "velocities", "accelerations")


def goal_monitor(
    goal: Any, names: Sequence[str], options: TrajectoryActionOptions, now: float
) -> GoalMonitor:
    """Create the monitor of a goal.

    Raises:
        InputError: The goal is invalid, or ended in the past.
    """
    multi_dof = goal.multi_dof_trajectory
    if multi_dof.joint_names or multi_dof.points:
        raise InputError(
            "multi_dof_trajectory must be empty: the platform's axes are joints here "
            "(trajectory_execution.control_multi_dof_joint_variables of MoveIt)"
        )
    if goal.component_path_tolerance or goal.component_goal_tolerance:
        raise InputError("component tolerances must be empty, as multi_dof_trajectory is")
    given = list(goal.trajectory.joint_names)
    unknown = [name for name in given if name not in names]
    if unknown:
        raise InputError(
            f"no joint {abbreviate_names(unknown)}; the joints are {abbreviate_names(names)}"
        )
    if not given or len(set(given)) != len(given):
        raise InputError(f"joint names must be given once each: {abbreviate_names(given)}")
    tolerances = GoalTolerances.of_goal(
        names,
        options,
        goal.path_tolerance,
        goal.goal_tolerance,
        time_seconds(goal.goal_time_tolerance),
    )
    target = np.full(len(names), np.nan)
    target[[names.index(name) for name in given]] = _last_positions(goal.trajectory, now)
    return GoalMonitor(names, target, tolerances)


def _last_positions(trajectory: JointTrajectory, now: float) -> Array:
    if not trajectory.points:
        raise InputError("the trajectory has no points")
    last, stamp = trajectory.points[-1], time_seconds(trajectory.header.stamp)
    age = now - (stamp + time_seconds(last.time_from_start))
    if stamp and age > 0.0:
        raise InputError(f"the trajectory ended {age:.2f} s ago")
    if len(last.positions) != len(trajectory.joint_names):
        raise InputError(
            f"{len(last.positions)} positions for {len(trajectory.joint_names)} joints"
        )
    positions = np.array(last.positions)
    plausible.demand(positions, plausible.ANGLE, "positions")
    return positions


def fill_feedback(
    feedback: Any,
    stamp: Time,
    desired: tuple[Array, ...],
    actual: tuple[Array, ...],
    errors: tuple[Array, ...],
) -> None:
    """Write the motion of n axes into a feedback of the action.

    Args:
        desired: Reference positions, velocities and accelerations, (n,) each.
        actual: Measured positions and velocities, (n,) each.
        errors: Errors of positions and velocities, (n,) each.
    """
    feedback.header.stamp = stamp
    for point, arrays in (
        (feedback.desired, desired),
        (feedback.actual, actual),
        (feedback.error, errors),
    ):
        for label, values in zip(PARTS, arrays, strict=False):
            setattr(point, label, array("d", values.tobytes()))
