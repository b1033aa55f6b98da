"""Calibration campaigns without a plant, with evenly turning wheels and exact or noisy poses."""

import math

import numpy as np

from omniman_ros.control.odometry import OdometryParameters
from omniman_ros.identification.odometry.campaign import Accuracy, CalibrationRun, Campaign
from omniman_ros.identification.odometry.wheel_integration import (
    compose,
    forward_matrix,
    integrate,
)
from test.robots import kinematics, robot

HALF_TURN = math.pi
TAPE = Accuracy(0.003, math.radians(0.3))

ALL_WAYS = {
    "ahead": [(1.6, 0, 0)],
    "left": [(0, 1.6, 0)],
    "half turn left": [(0, 0, HALF_TURN)],
    "back": [(-1.6, 0, 0)],
    "diagonal": [(1.2, 1.2, 0)],
    "half turn right": [(0, 0, -HALF_TURN)],
    "right": [(0, -1.6, 0)],
    "other diagonal": [(1.2, -1.2, 0)],
    "ahead and half turn": [(1.5, 0, 0), (0, 0, HALF_TURN)],
    "arc": [(1.0, 0.5, 1.0)],
    "left and half turn": [(0, 1.5, 0), (0, 0, -HALF_TURN)],
    "turns right": [(0, 0, -3 * HALF_TURN)],
    "ahead 2": [(1.6, 0, 0)],
    "turns left": [(0, 0, 3 * HALF_TURN)],
}  #: Legs of each run: displacements (x, y, turn) of constant twist in the robot's frame


def runs(name, ways, scale=1.0):
    """Make runs whose wheels turn as the configured kinematics demand."""
    model = kinematics(name)
    made, position = [], np.zeros(model.wheel_count)
    for label, legs in ways.items():
        steps = np.array([model.J @ np.array(leg, dtype=float) * scale for leg in legs])
        positions = position + np.vstack([np.zeros(len(position)), np.cumsum(steps, axis=0)])
        made.append(CalibrationRun(label, positions))
        position = positions[-1]
    return tuple(made)


def true_poses(name, made, true, start=(0.3, -0.2, 2.0)):
    """Return the poses (N + 1, 3) of a robot whose odometry is exact with these parameters."""
    forward = forward_matrix(robot(name).wheels, true)
    poses = [np.array(start)]
    for run in made:
        poses.append(compose(poses[-1], integrate(forward, run.positions)[-1]))
    return np.array(poses)


def campaign(
    true=None, name="omniman", ways=None, noise=None, rng=None, accuracy=TAPE, skip=(), off=None
):
    """Make a campaign of a robot whose odometry is exact with the parameters `true`.

    Args:
        true: Parameters with which the odometry is exact.
        ways: Legs of the runs; ALL_WAYS if None.
        noise: Accuracy of the poses, whose errors are drawn from `rng`; exact if None.
        skip: Indices of poses that are not measured.
        off: Errors (3,) of poses by their index.
    """
    made = runs(name, ways or ALL_WAYS)
    poses = true_poses(name, made, true or OdometryParameters())
    if noise is not None:
        deviation = [noise.position, noise.position, noise.heading]
        poses = poses + rng.normal(size=poses.shape) * deviation
    for index, error in (off or {}).items():
        poses[index] += error
    poses[:, 2] = np.remainder(poses[:, 2] + np.pi, 2 * np.pi) - np.pi  # as users measure them
    measured = tuple(
        None if i in skip else tuple(map(float, pose)) for i, pose in enumerate(poses)
    )
    return Campaign(robot(name).wheels, made, measured, accuracy)


def random_factors(rng, spread=0.02):
    """Return parameters with nine random factors."""
    draw = rng.uniform(-spread, spread, 9)
    names = (
        "x_per_y",
        "x_per_yaw",
        "y_per_x",
        "y_per_yaw",
        "yaw_per_x",
        "yaw_per_y",
    )
    return OdometryParameters(
        scale_x=1 + draw[0],
        scale_y=1 + draw[1],
        scale_yaw=1 + draw[2],
        **dict(zip(names, draw[3:].tolist(), strict=True)),
    )
