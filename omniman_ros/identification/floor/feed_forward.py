"""How well computed torques meet the currents that a drive needed."""

from dataclasses import dataclass

import numpy as np

from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.arrays import Array
from omniman_ros.core.platform import Platform
from omniman_ros.identification.floor.floor_drive import FloorDrive
from omniman_ros.identification.floor.windows import Windows

WINDOW_WIDTH = 0.3  #: Width of the windows in which currents are compared [s]
WINDOW_STEP = 0.1  #: Distance between two windows [s]


@dataclass(frozen=True)
class FeedForwardResidual:
    """Differences between measured and computed motor currents, RMS over motors and time."""

    motion: float  #: The part that moves the platform: wheel torques in the range of J [A]
    strain: float  #: The part by which the wheels strain against one another [A]


def feed_forward_residual(drive: FloorDrive, robot: Platform) -> FeedForwardResidual:
    """Return what the feed-forward leaves to the drives' controllers.

    The feed-forward of a robot's parameters is evaluated at the measured motion.

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
    difference = currents - np.array(computed)
    motion = difference @ kinematics.J @ kinematics.J_pinv
    return FeedForwardResidual(_rms(motion), _rms(difference - motion))


def _rms(table: Array) -> float:
    return float(np.sqrt((table**2).mean()))
