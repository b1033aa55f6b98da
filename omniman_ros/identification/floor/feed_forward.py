"""How well computed torques meet the currents that a drive needed."""

import numpy as np

from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.robot import Robot
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.windows import Windows

WINDOW_WIDTH = 0.3
"""Width of the windows in which currents are compared [s]."""
WINDOW_STEP = 0.1
"""Distance between two windows [s]."""


def feed_forward_residual(drive: FloorDrive, robot: Robot) -> Array:
    """Return what the feed-forward leaves to the drives' controllers.

    The feed-forward of a robot's parameters is evaluated at the measured motion.

    Args:
        drive: A recorded drive.
        robot: Parameters, with calibrated wheel radii.

    Returns:
        RMS (n,) of the difference between measured and computed current of each motor [A].

    Raises:
        InputError: The drive is too short or has gaps.
    """
    kinematics = PlatformKinematics(robot.wheels)
    dynamics = PlatformDynamics(robot, kinematics)
    windows = Windows(drive.start, drive.end, WINDOW_WIDTH, WINDOW_STEP)
    speeds = windows.mean(drive.times, drive.positions, 1)
    twists = speeds @ kinematics.J_pinv.T
    rates = windows.mean(drive.times, drive.positions, 2) @ kinematics.J_pinv.T
    currents = windows.mean(drive.electrical_times, drive.currents)
    computed = [
        dynamics.current(
            dynamics.platform_torque(twist, rate) + dynamics.friction_torque(twist, speed), speed
        )
        for twist, rate, speed in zip(twists, rates, speeds, strict=True)
    ]
    result: Array = np.sqrt(((currents - np.array(computed)) ** 2).mean(axis=0))
    return result
