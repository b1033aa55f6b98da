"""Odometry after the path of CCTA 2017, Fig. 7, by the wheels alone and with an inertial sensor.

Both odometries receive the states of the same wheels in the same drive, so that they differ by
the sensor alone. The controller drives by the wheels.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from omniman_ros.control.wheel_odometry import WheelOdometry, WheelOdometryParameters
from omniman_ros.core.arbiter import Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.imu_mount import ImuMount
from omniman_ros.core.parameters import build
from omniman_ros.core.planar import Triple
from omniman_ros.core.platform import Platform
from omniman_ros.core.se2 import wrap
from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD, ClosedLoop
from omniman_ros.lab.studies.coupling import GROUPS, NO_FOLLOWING_ERROR_STOP, draw_mismatch
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.figure7 import Figure7
from omniman_ros.simulation.plant.imu import ImuSensorParameters, SimulatedImu, planar_motion
from omniman_ros.simulation.plant.parameters import SimulationParameters

REST = 1.5  #: time of rest before the path, which shows the bias of the yaw rate, and after [s]
IMU_STRIDE = 2  #: ticks from one measurement of the inertial sensor to the next: 100 Hz


@dataclass(frozen=True)
class OdometryCase:
    """One drive."""

    group: str  #: how the drives hold a wheel's speed, a key of `GROUPS`
    sample: int  #: index of the set of random wheels
    roller_lag: float  #: lag of the rollers that coupling control knows [s]
    seed: int  #: seed of the random wheels


def drive_odometry(
    robot: Mapping[str, Any], world: WorldChoice | None, figure: Figure7, case: OdometryCase
) -> dict[str, Any]:
    """Drive along the path once; return the figures, with the units in their names."""
    values = {
        **robot,
        **GROUPS[case.group].changes,
        **NO_FOLLOWING_ERROR_STOP,
        "coupling.roller_lag": case.roller_lag,
    }
    wheels = build(Platform, values).wheel_count
    mismatch = draw_mismatch(case.group, case.seed, case.sample, wheels)
    loop = ClosedLoop.of_robot(values, world, mismatch)
    observer = _Observer(values, loop)
    observer.run(REST)
    for leg in figure.legs(loop.now):
        observer.run(leg.begin - loop.now)
        loop.send(Source.PATH, leg.preview)
        observer.run(leg.preview.end - loop.now)
    observer.run(REST)
    loop.check(case)
    return {
        "group": case.group,
        "about": GROUPS[case.group].about,
        "roller_lag_s": case.roller_lag,
        "sample": case.sample,
        "largest_mm": 1e3 * observer.largest,
        "wheels": _figures(loop.controller.odometry.pose, loop.truth),
        "imu": _figures(observer.core.odometry.pose, loop.truth),
    }


class _Observer:
    """An odometry with an inertial sensor beside a closed loop."""

    def __init__(self, values: Mapping[str, Any], loop: ClosedLoop) -> None:
        self._loop, self.largest = loop, 0.0
        self.core = WheelOdometry(build(WheelOdometryParameters, values))
        self._imu = SimulatedImu(
            build(ImuMount, values, "imu."),
            build(ImuSensorParameters, values, "imu_sensor."),
            build(SimulationParameters, values).plant.gravity,
        )

    def run(self, seconds: float) -> None:
        """Run loop and odometry for a time [s]."""
        loop = self._loop
        for _ in range(round(seconds / PERIOD)):
            now = loop.now
            loop.step()
            if loop.tick % IMU_STRIDE == 0:
                motion = (
                    planar_motion(loop.drives.ground_truth()[1])
                    if loop.world is None
                    else loop.world.base_motion
                )
                measured = self._imu.measure(now, motion)
                if measured is not None:
                    self.core.imu.update(now, now, *measured)
            states = loop.states
            self.core.update_wheels(now, now + LATENCY, states.position, states.velocity)
            x, y, _ = loop.controller.odometry.pose
            self.largest = max(self.largest, math.hypot(x - loop.truth[0], y - loop.truth[1]))


def _figures(pose: Triple, truth: Array) -> dict[str, float]:
    """Return distance and heading error of a pose by odometry [m, m, rad] from the true one."""
    return {
        "end_mm": 1e3 * math.hypot(pose[0] - truth[0], pose[1] - truth[1]),
        "heading_mrad": 1e3 * wrap(pose[2] - float(truth[2])),
    }
