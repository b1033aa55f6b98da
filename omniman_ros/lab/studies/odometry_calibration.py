"""The calibration of a robot's odometry by drives whose ends are measured.

The robot drives straight ahead, sideways, and rotates in place. Odometry assumes that a wheel
touches the floor in its middle, with a roller's axis level there; wheels with rollers go less far
sideways, and soft tyres less far altogether.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.plant.parameters import SimulationParameters

TRAVEL = 2.0  # length of the straight drives [m]
SPEED = 0.3  # speed of the straight drives [m/s]
TURN = math.tau  # angle of the rotation [rad]
YAW_RATE = 0.5  # yaw rate of the rotation [rad/s]
SETTLING = 1.5  # time from the last setpoint of a drive to its end [s]
RUNS = (
    ("odometry.scale_x", 0, SPEED, TRAVEL),
    ("odometry.scale_y", 1, SPEED, TRAVEL),
    ("odometry.scale_yaw", 2, YAW_RATE, TURN),
)
"""The drives: the scale that is measured, its component of the twist, the speed in that direction
[m/s or rad/s] and the way by the setpoints [m or rad]."""


def calibrate(robot: Mapping[str, Any], world: WorldChoice | None) -> dict[str, float]:
    """Return the scales of the odometry: true over measured way."""
    parameters, simulation = build(PlatformParameters, robot), build(SimulationParameters, robot)
    scales = {}
    for name, component, speed, way in RUNS:
        loop = ClosedLoop(parameters, simulation, torques=False, world=world)
        twist, start = np.zeros(3), loop.truth[component]
        twist[component] = speed
        for _ in range(round(way / speed / PERIOD)):
            loop.controller.set_twist(twist, loop.now)
            loop.step()
        for _ in range(round(SETTLING / PERIOD)):
            loop.step()
        measured = loop.controller.odometry.pose[component]
        scales[name] = float(loop.truth[component] - start) / measured
    return scales
