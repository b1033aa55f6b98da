"""Calibration campaigns without a plant: wheels that turn evenly, poses exact or noisy."""

import math

import numpy as np
from robots import kinematics, robot

from omniman_ros.core.calibration import (
    Accuracy,
    Campaign,
    Run,
    compose,
    forward_matrix,
    integrate,
)
from omniman_ros.core.odometry import OdometryParameters

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
}
"""Run: legs of constant twist, each (x, y, turn) in the robot's frame as configured."""


def runs(name, ways, scale=1.0):
    """Runs whose wheels turn as the configured kinematics say."""
    model = kinematics(name)
    made, position = [], np.zeros(model.wheel_count)
    for label, legs in ways.items():
        steps = np.array([model.J @ np.array(leg, dtype=float) * scale for leg in legs])
        positions = position + np.vstack([np.zeros(len(position)), np.cumsum(steps, axis=0)])
        made.append(Run(label, positions))
        position = positions[-1]
    return tuple(made)


def true_poses(name, made, true, start=(0.3, -0.2, 2.0)):
    """Poses (N + 1, 3) of a robot whose odometry would be right with the parameters `true`."""
    forward = forward_matrix(robot(name).wheels, true)
    poses = [np.array(start)]
    for run in made:
        poses.append(compose(poses[-1], integrate(forward, run.positions)[-1]))
    return np.array(poses)


def campaign(
    true=None, name="omniman", ways=None, noise=None, rng=None, accuracy=TAPE, skip=(), off=None
):
    """A campaign of a robot that is as `true` says.

    Args:
        true: OdometryParameters that would be right.
        name: Of the robot.
        ways: Runs; ALL_WAYS if None.
        noise: Accuracy of which errors are drawn from `rng`; exact poses if None.
        accuracy: That is stated.
        skip: Indices of poses that are not measured.
        off: Index of a pose to an error (3,) of it.
    """
    made = runs(name, ways or ALL_WAYS)
    poses = true_poses(name, made, true or OdometryParameters())
    if noise is not None:
        deviation = [noise.position, noise.position, noise.heading]
        poses = poses + rng.normal(size=poses.shape) * deviation
    for index, error in (off or {}).items():
        poses[index] += error
    poses[:, 2] = np.remainder(poses[:, 2] + np.pi, 2 * np.pi) - np.pi  # as people measure it
    measured = tuple(
        None if i in skip else tuple(map(float, pose)) for i, pose in enumerate(poses)
    )
    return Campaign(robot(name).wheels, made, measured, accuracy)


def random_factors(rng, spread=0.02):
    """Parameters with nine random factors."""
    draw = rng.uniform(-spread, spread, 9)
    names = (
        "x_per_y", "x_per_yaw", "y_per_x", "y_per_yaw", "yaw_per_x", "yaw_per_y",
    )  # fmt: skip
    return OdometryParameters(
        scale_x=1 + draw[0], scale_y=1 + draw[1], scale_yaw=1 + draw[2],
        **dict(zip(names, draw[3:].tolist(), strict=True)),
    )  # fmt: skip
