"""The leg of the demo that is driven through `cmd_vel`: body twists as functions of time."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.driver import PAUSE, Driver
from omniman_ros.demo.leg import Leg
from omniman_ros.demo.limits import Limit
from omniman_ros.demo.recorder import Recording

MAX_SPEED = 0.3
"""Largest linear speed of the twists [m/s]."""
MAX_YAW_RATE = 0.8
"""Largest yaw rate of the twists [rad/s]."""
SETTLING_TIME = 1.0
"""Time after which the robot is expected to drive the commanded twist [s]."""


@dataclass(frozen=True)
class Pace:
    """Speeds of the demo, well within the limits of a robot.

    Attributes:
        speed: Linear speed of the twists [m/s].
        yaw_rate: Yaw rate of the twists [rad/s].
    """

    speed: float = 0.3
    yaw_rate: float = 0.6

    @classmethod
    def within(cls, limits: TwistLimits) -> "Pace":
        """Return the pace for the limits of a robot."""
        return cls(
            speed=min(MAX_SPEED, 0.5 * limits.linear_velocity),
            yaw_rate=min(MAX_YAW_RATE, 0.5 * limits.angular_velocity),
        )


@dataclass(frozen=True)
class TwistPhase:
    """A body twist for some time.

    Attributes:
        name: Name for display.
        duration: Duration [s].
        twist: Function from the time since the start [s] to x', y' [m/s] and theta' [rad/s] in
            base_link.
    """

    name: str
    duration: float
    twist: Callable[[float], Triple]


@dataclass(frozen=True)
class DrivenPhase:
    """A phase that has been driven.

    Attributes:
        phase: The phase.
        start: ROS time at which it began [s].
    """

    phase: TwistPhase
    start: float


def twist_phases(pace: Pace) -> list[TwistPhase]:
    """Return the phases: a diagonal, a rotation on the spot, and a circle with rotation."""
    speed, yaw_rate = pace.speed, pace.yaw_rate
    lap_time = 5.0
    diagonal = speed / math.sqrt(2.0)
    # The direction of travel rotates in base_link so that the path is a circle in the world.
    course_rate = math.tau / lap_time - 0.75 * yaw_rate

    def circle(t: float) -> Triple:
        return (
            speed * math.cos(course_rate * t),
            speed * math.sin(course_rate * t),
            0.75 * yaw_rate,
        )

    return [
        TwistPhase("diagonal", 2.5, lambda t: (diagonal, diagonal, 0.0)),
        TwistPhase("spin", 3.0, lambda t: (0.0, 0.0, yaw_rate)),
        TwistPhase("circle + spin", lap_time, circle),
    ]


def twist_error(odom: Array, driven: DrivenPhase) -> dict[str, Any]:
    """Return the difference between the mean and the commanded twist, once it had settled.

    Args:
        odom: Rows (k, 7) of `Recording.odom`.
        driven: The phase that was driven.

    Returns:
        Name of the phase and its errors [m/s, rad/s], which are infinite without odometry.
    """
    elapsed = odom[:, 0] - driven.start
    settled = (elapsed >= SETTLING_TIME) & (elapsed <= driven.phase.duration)
    if not settled.any():
        return {"name": driven.phase.name, "linear_m_s": math.inf, "angular_rad_s": math.inf}
    setpoints = np.array([driven.phase.twist(t) for t in elapsed[settled].tolist()])
    mean = (odom[settled, 4:7] - setpoints).mean(axis=0)
    return {
        "name": driven.phase.name,
        "linear_m_s": math.hypot(mean[0], mean[1]),
        "angular_rad_s": abs(float(mean[2])),
    }


class TwistLeg(Leg):
    """Drives body twists, each from rest to rest.

    Args:
        pace: Speeds of the twists.

    Attributes:
        driven: The phases that have been driven.
    """

    limits = (
        Limit("twists.linear_m_s", "twist error, m/s", 0.03),
        Limit("twists.angular_rad_s", "twist error, rad/s", 0.05),
    )

    def __init__(self, pace: Pace) -> None:
        self._phases = twist_phases(pace)
        self.driven: list[DrivenPhase] = []

    def drive(self, driver: Driver) -> None:
        """Drive all phases."""
        for phase in self._phases:
            driver.progress.begin(phase.name)
            self.driven.append(DrivenPhase(phase, driver.now))
            for elapsed in driver.ticks(phase.duration):
                driver.robot.send_twist(phase.twist(elapsed))
                driver.progress.update(elapsed / phase.duration, driver.note)
            for _ in driver.ticks(PAUSE):
                driver.halt()
            driver.progress.end(driver.note)

    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return the error of each phase under `twists`."""
        odom = np.array(recording.odom)
        return {"twists": [twist_error(odom, driven) for driven in self.driven]}
