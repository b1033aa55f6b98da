"""Travel along the diagonals of the rollers, and the power that it takes."""

import math
from typing import Any

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.lab.studies.recorded_drive import Drive
from omniman_ros.planning.mpc.model import PlanningModel
from omniman_ros.planning.route import energy_saving

NEAR_DIAGONAL = math.radians(10.0)
"""Angle from a roller diagonal up to which the robot counts as travelling along it [rad]."""


def roller_diagonals(robot: Robot) -> Array:
    """Return the directions along which only some of the wheels drive.

    A wheel pushes along its roller's axis; when the robot travels across that axis, the wheel
    stands still.

    Returns:
        (k,) directions in base_link, in (-pi/2, pi/2] [rad].
    """
    angles = np.array(robot.wheels.heading) + np.array(robot.wheels.roller_angle)
    half_turns: Array = np.unique(np.round(math.pi / 2 - (math.pi / 2 - angles) % math.pi, 6))
    return half_turns


def angle_from_diagonal(angles: Array, robot: Robot) -> Array:
    """Return the angles (k,) of directions of travel (k,) from the nearest diagonal [rad]."""
    deviation = angles[:, None] - roller_diagonals(robot)
    result: Array = np.abs((deviation + math.pi / 2) % math.pi - math.pi / 2).min(axis=1)
    return result


def steady_power(robot: Robot, speed: float, directions: Array) -> Array:
    """Compute the electric power that keeps a constant speed, by direction of travel.

    The currents are the smallest that balance the model's friction.

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
    """Return whether and when the robot travelled along a diagonal of its rollers."""
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
