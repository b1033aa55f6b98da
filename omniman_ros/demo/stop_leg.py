"""The leg of the demo that presses the emergency stop while platform and arm move."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from omniman_ros.console.errors import CommandError
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.driver import PAUSE, Driver
from omniman_ros.demo.leg import Leg
from omniman_ros.demo.limits import Limit
from omniman_ros.demo.recorder import Recording

DRIVING_TIME = 1.2
"""Time for which the robot drives before the emergency stop [s]."""
STOPPED_TIME = 1.5
"""Time for which twists are still sent while the emergency stop is pressed [s]."""
WATCHED_TIME = 1.0
"""Time for which the robot is watched after the reset [s]."""
ARM_SWING = np.array([0.9, 0.0, 0.0, 0.0, 0.0, 1.2])
"""Change of the joint angles during which the arm is stopped [rad]."""
ARM_SWING_TIME = 3.0
"""Time that this change would take without the stop [s]."""
REST_SPEED = 0.01
"""Speed below which platform and arm count as at rest [m/s, rad/s]."""
ARM_SPEED_STEP = 0.05
"""Time step of the difference quotient that gives the arm's speed [s]."""


@dataclass(frozen=True)
class DrivenStop:
    """An emergency stop, in ROS time.

    Attributes:
        pressed: Time at which the emergency stop was pressed [s].
        reset: Time at which the reset was answered [s].
        end: Time until which the robot was watched [s].
    """

    pressed: float
    reset: float
    end: float


def stop_figures(recording: Recording, driven: DrivenStop) -> dict[str, Any]:
    """Return speed, time to rest and distance of the stop, and the motion after the reset.

    All are derived from odometry and from the arm's measured angles. The figures of the arm are
    missing if there is none.
    """
    odom, arm = np.array(recording.odom), np.array(recording.arm)
    result: dict[str, Any] = {}
    speeds = np.hypot(odom[:, 4], odom[:, 5]) + np.abs(odom[:, 6])
    result["speed_m_s"], result["rest_s"] = _time_to_rest(odom[:, 0], speeds, driven)
    stopping = odom[(odom[:, 0] >= driven.pressed) & (odom[:, 0] <= driven.reset)]
    result["way_mm"] = 1e3 * float(np.hypot(*np.diff(stopping[:, 1:3], axis=0).T).sum())
    after = odom[(odom[:, 0] > driven.reset) & (odom[:, 0] <= driven.end)]
    moved = np.hypot(*(after[:, 1:3] - after[0, 1:3]).T).max() if len(after) else math.inf
    result["moved_mm"] = 1e3 * float(moved)
    if len(arm):
        before = np.column_stack(
            [np.interp(arm[:, 0] - ARM_SPEED_STEP, arm[:, 0], joint) for joint in arm[:, 1:].T]
        )
        rates = np.abs(arm[:, 1:] - before).max(axis=1) / ARM_SPEED_STEP
        result["arm_rate_rad_s"], result["arm_rest_s"] = _time_to_rest(arm[:, 0], rates, driven)
        after = arm[(arm[:, 0] > driven.reset) & (arm[:, 0] <= driven.end), 1:]
        moved = np.abs(after - after[0]).max() if len(after) else math.inf
        result["arm_moved_mrad"] = 1e3 * float(moved)
    return result


class StopLeg(Leg):
    """Presses the emergency stop in motion, continues to send twists, and resets the robot.

    Args:
        speed: Forward velocity before the stop [m/s].

    Attributes:
        driven: The stop, once the robot has been reset.
    """

    limits = (
        Limit("emergency_stop.rest_s", "at rest after an emergency stop, s", 1.0),
        Limit("emergency_stop.arm_rest_s", "arm at rest after an emergency stop, s", 1.0),
        Limit("emergency_stop.moved_mm", "moved after the reset, mm", 1.0),
        Limit("emergency_stop.arm_moved_mrad", "arm moved after the reset, mrad", 1.0),
    )

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self.driven: DrivenStop | None = None

    def drive(self, driver: Driver) -> None:
        """Drive, stop, and reset the robot.

        Raises:
            CommandError: The robot did not stop, or cannot be reset.
        """
        driver.progress.begin("emergency stop")
        driver.wait_until_idle()
        forwards: Triple = (self._speed, 0.0, 0.0)
        if driver.has_arm:
            driver.robot.send_arm_goal(driver.arm_angles + ARM_SWING, ARM_SWING_TIME)
        for _ in driver.ticks(DRIVING_TIME):
            driver.robot.send_twist(forwards)
        pressed, driver.expects_stop = driver.now, True
        driver.robot.send_emergency_stop(pressed=True)
        for _ in driver.ticks(STOPPED_TIME):
            driver.robot.send_twist(forwards)
        if not driver.recorder.stopped:
            raise CommandError("the emergency stop did not stop the robot")
        driver.progress.update(0.5, driver.note)
        driver.robot.send_emergency_stop(pressed=False)
        driver.pause(PAUSE)
        driver.reset_all()
        driver.expects_stop, reset = False, driver.now
        driver.pause(WATCHED_TIME)
        self.driven = DrivenStop(pressed, reset, driver.now)
        driver.progress.end(driver.note)

    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return speeds, times and distances under `emergency_stop`."""
        return {"emergency_stop": stop_figures(recording, self.driven)} if self.driven else {}


def _time_to_rest(times: Array, speeds: Array, driven: DrivenStop) -> tuple[float, float]:
    """Return the speed when the stop is pressed, and the time from then to rest [s].

    Args:
        times: ROS times (k,) [s].
        speeds: Speeds (k,) at these times.
        driven: The stop.

    Returns:
        Speed and time; NaN and infinity if the robot did not come to rest before the reset.
    """
    before, during = times < driven.pressed, (times >= driven.pressed) & (times <= driven.reset)
    stamps, braking = times[during], speeds[during]
    if not before.any() or not len(stamps) or braking[-1] > REST_SPEED:
        return math.nan, math.inf
    moving = np.flatnonzero(braking > REST_SPEED)
    rest = float(stamps[moving[-1]] - driven.pressed) if len(moving) else 0.0
    return float(speeds[before][-1]), rest
