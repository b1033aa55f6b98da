"""What is measured of a robot before a drive: the scales of its odometry, the lag of its rollers.

Odometry assumes that a wheel touches the floor in its middle, with a roller's axis level there;
wheels with rollers go less far sideways, and soft tyres less far altogether. The robot drives
straight ahead, sideways, and rotates in place, and the ends are measured.

The lag is measured by a rotation in place, from the controller's odometry alone, as on a real
robot. Without coupling control and in torque mode, where little holds the wheels against each
other, the coupling error changes as the rollers have it.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from omniman_ros.control.coupling_controller import CouplingController, CouplingParameters
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice

SETTLING = 1.5  #: time from the last setpoint of a drive to its end, and before the lag [s]
#: The drives: the scale that is measured, its component of the twist, the speed in that direction
#: [m/s or rad/s] and the way by the setpoints [m or rad].
RUNS = (
    ("odometry.scale_x", 0, 0.3, 2.0),
    ("odometry.scale_y", 1, 0.3, 2.0),
    ("odometry.scale_yaw", 2, 0.5, math.tau),
)
UNIT = 0.01  #: lag to which the measured one is related [s]
YAW_RATE = 0.6  #: yaw rate of the rotation that measures the lag [rad/s]
DURATION = 6.0  #: duration of the measurement of the lag [s]
#: Parameters with which nothing but the floor decides on the coupling error
COMPLIANT = {"drive.mode": "torque", "coupling.k_epsilon": 0.0, "drive.following_error": 100.0}


def calibrate(robot: Mapping[str, Any], world: WorldChoice | None) -> dict[str, float]:
    """Return the scales of the odometry: true over measured way."""
    scales = {}
    for name, component, speed, way in RUNS:
        loop = ClosedLoop.of_robot(robot, world)
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


def measure_roller_lag(
    robot: Mapping[str, Any], world: WorldChoice | None, duration: float = DURATION
) -> float:
    """Return the lag that explains the coupling error of a rotation in place best [s]."""
    loop = ClosedLoop.of_robot({**robot, **COMPLIANT}, world)
    core = loop.controller
    unit = CouplingController(core.cascade.kinematics, CouplingParameters(roller_lag=UNIT))
    expected, before = np.zeros_like(unit.error), unit.error
    for tick in range(round((SETTLING + duration) / PERIOD)):
        core.set_twist(np.array([0.0, 0.0, YAW_RATE]), loop.now)
        loop.step()
        odometry = core.odometry
        if tick * PERIOD < SETTLING:
            before = odometry.coupling_error
            continue
        rate = unit.expected_rate(loop.states.velocity, float(odometry.twist[2]))
        expected = expected + PERIOD * rate
    change = core.odometry.coupling_error - before
    return max(UNIT * float(expected @ change) / float(expected @ expected), 0.0)
