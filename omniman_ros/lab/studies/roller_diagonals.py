"""Travel along the roller diagonals of a Mecanum platform, and the electric power it requires."""

import math
from typing import Any

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.recorded_drive import Drive
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.route import energy_saving

NEAR_DIAGONAL = math.radians(10.0)
"""Largest angle from a roller diagonal at which travel still counts as along it [rad]."""


def roller_diagonals(robot: Robot) -> Array:
    """Return the directions of travel in which at least one wheel stands still.

    A wheel pushes along the axis of the roller that touches the floor. When the robot travels
    perpendicular to that axis, the wheel stands still.

    Returns:
        (k,) directions in base_link, ascending, in (-pi/2, pi/2] [rad].
    """
    angles = np.array(robot.wheels.heading) + np.array(robot.wheels.roller_angle)
    half_turns: Array = np.unique(np.round(math.pi / 2 - (math.pi / 2 - angles) % math.pi, 6))
    return half_turns


def angle_from_diagonal(angles: Array, robot: Robot) -> Array:
    """Return the angles (k,) from directions of travel (k,) to their nearest diagonals [rad]."""
    deviation = angles[:, None] - roller_diagonals(robot)
    result: Array = np.abs((deviation + math.pi / 2) % math.pi - math.pi / 2).min(axis=1)
    return result


def steady_power(robot: Robot, speed: float, directions: Array) -> Array:
    """Compute the electric power that sustains a constant speed, by direction of travel.

    Of all currents that balance the friction of the planner's model, the smallest are used.

    Args:
        robot: The robot.
        speed: Speed of the platform [m/s].
        directions: (k,) directions of travel in base_link [rad].

    Returns:
        (k,) powers [W].
    """
    twists = speed * np.column_stack(
        [np.cos(directions), np.sin(directions), np.zeros(len(directions))]
    )
    return energy_saving.power(PlanningModel.of(robot), twists)


def diagonal_figures(drive: Drive, robot: Robot) -> dict[str, Any]:
    """Return figures that tell whether a drive led along a roller diagonal; units are in names.

    `share` is the share of the time in motion that was spent along a diagonal, `nearest_rad` the
    smallest angle to a diagonal at any time and `nearest_s` that time. `peak_turn_rad` is the
    largest rotation away from the initial heading and `peak_turn_s` its time, which is missing if
    the robot never moved.
    """
    times, angles = drive.travel_directions()
    deviation = angle_from_diagonal(angles, robot)
    if not len(deviation):
        return {
            "along_diagonal": False,
            "share": 0.0,
            "nearest_rad": math.nan,
            "nearest_s": math.nan,
            "peak_turn_rad": 0.0,
        }
    near = deviation <= NEAR_DIAGONAL
    rotation = np.abs(drive.poses[:, 2] - drive.poses[0, 2])
    return {
        "along_diagonal": bool(near.mean() > 0.5),
        "share": float(near.mean()),
        "nearest_rad": float(deviation.min()),
        "nearest_s": float(times[deviation.argmin()]),
        "peak_turn_rad": float(rotation.max()),
        "peak_turn_s": float(drive.times[rotation.argmax()]),
    }
