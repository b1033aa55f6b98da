"""The lag of a robot's rollers, measured by a rotation in place.

Only what a real robot has is used: the controller's odometry. Without coupling control and in
torque mode, where little holds the wheels against each other, the coupling error changes as the
rollers have it.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from omniman_ros.control.coupling_controller import CouplingController, CouplingParameters
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.parameters import build
from omniman_ros.lab.studies.closed_loop import PERIOD, ClosedLoop
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.simulation.plant.parameters import SimulationParameters

UNIT = 0.01  # lag to which the measured one is related [s]
YAW_RATE = 0.6  # yaw rate of the rotation [rad/s]
SETTLING = 1.5  # time from the start to the beginning of the measurement [s]
DURATION = 6.0  # duration of the measurement [s]
COMPLIANT = {"drive.mode": "torque", "coupling.k_epsilon": 0.0, "drive.following_error": 100.0}
"""Parameters with which nothing but the floor decides on the coupling error."""


def measure_roller_lag(
    robot: Mapping[str, Any], world: WorldChoice | None, duration: float = DURATION
) -> float:
    """Return the lag that explains the coupling error of a rotation in place best [s]."""
    values = {**robot, **COMPLIANT}
    loop = ClosedLoop(
        build(PlatformParameters, values),
        build(SimulationParameters, values),
        torques=False,
        world=world,
    )
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
