"""The leg of the demo that follows the path of CCTA 2017, Fig. 7, while the arm moves."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.driver import Driver
from omniman_ros.demo.interval import Interval
from omniman_ros.demo.leg import Leg
from omniman_ros.demo.limits import Limit
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.tracking import Reference, coupling_figures, tracking_figures
from omniman_ros.motion.figure7 import Movement, movements

SPACING = 0.02
"""Largest distance between two poses of a path [m]."""
ARM_POSES = (
    (0.6, -0.5, 0.9, -0.4, 0.4, 0.8),
    (-0.5, -0.2, 0.4, -0.8, -0.6, -0.7),
    (0.3, -0.7, 0.2, 0.5, 0.7, 0.4),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
)
"""Joint angles to which the arm moves in each movement, relative to those at the start [rad]."""


def to_odom(poses: Array, origin: Triple) -> Array:
    """Transform poses (k, 3) from a frame whose pose in odom is `origin` to odom [m, m, rad]."""
    result: Array = poses @ se2.rotation(origin[2]) + np.array(origin)
    return result


def poses_along(movement: Movement, origin: Triple) -> Array:
    """Return the poses (k, 3) in odom of a movement whose frame is at `origin` [m, m, rad]."""
    steps = max(2, math.ceil(movement.length / SPACING))
    return to_odom(movement.at(np.linspace(0.0, movement.length, steps + 1))[0], origin)


class PathLeg(Leg):
    """Follows the path, movement by movement; an arm moves at the same time.

    Attributes:
        movements: Intervals in which the movements were driven.
    """

    limits = (
        Limit("tracking.rms_mm", "tracking RMS, mm", 5.0),
        Limit("tracking.max_mm", "tracking max, mm", 20.0),
        Limit("tracking.final_mm", "final position, mm", 10.0),
        Limit("tracking.final_heading_deg", "final heading, deg", 1.0),
    )

    def __init__(self) -> None:
        self.movements: list[Interval] = []

    def drive(self, driver: Driver) -> None:
        """Drive the path from the robot's present pose.

        Raises:
            CommandError: Another source drives the platform, or a movement failed.
        """
        if not driver.wait_until_idle():
            source = driver.recorder.active_source
            raise CommandError(f"'{source}' still drives the platform, expected none")
        origin = driver.pose
        arm_start = driver.arm_angles if driver.has_arm else None
        for i, movement in enumerate(movements()):
            if arm_start is not None:
                driver.begin_arm_move(arm_start + np.array(ARM_POSES[i % len(ARM_POSES)]))
            poses = poses_along(movement, origin)
            driven = driver.follow_path(f"path: {movement.name}", poses, movement.length)
            self.movements.append(replace(driven, name=movement.name))
            if driver.has_arm:
                driver.end_arm_move(driven.end)

    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return the errors of `tracking` and `coupling`."""
        odom, reference = np.array(recording.odom), Reference(recording.reference)
        return {
            "tracking": tracking_figures(odom, reference, self.movements),
            "coupling": coupling_figures(recording.coupling, self.movements),
        }
