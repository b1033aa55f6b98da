"""The leg of the demo that drives to a goal among obstacles, which cross its path."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.time import Time

from omniman_ros.console.errors import CommandError
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.driver import Driver
from omniman_ros.demo.leg import Bound, Interval, Leg, Limit
from omniman_ros.demo.moving_obstacles import MovingObstacles
from omniman_ros.demo.path_leg import to_odom
from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.tracking import wrap_angle

GOAL = (3.2, 0.3, 1.5707963)
"""Pose of the goal, beyond the obstacles, in the robot's frame at the start [m, m, rad]."""
GOAL_TIMEOUT = 30.0
"""Time within which the goal must be reached [s]."""
OBSERVATION_PERIOD = 0.05
"""Period of the observations of the obstacles [s]."""


@dataclass(frozen=True)
class DrivenGoal:
    """A goal that was reached among obstacles.

    Attributes:
        goal: Pose of the goal in odom [m, m, rad].
        obstacles: Obstacles on the way to the goal.
        interval: Interval in which the robot drove to the goal.
    """

    goal: Triple
    obstacles: MovingObstacles
    interval: Interval


def goal_figures(odom: Array, driven: DrivenGoal, half_size: Sequence[float]) -> dict[str, Any]:
    """Return the error at the goal and the smallest clearance of the obstacles on the way.

    Args:
        odom: Rows (k, 7) of `Recording.odom`.
        driven: The goal and its obstacles, both in odom.
        half_size: Half length and half width of the robot's bounding box [m].
    """
    during = odom[driven.interval.contains(odom[:, 0])]
    if not len(during):
        return dict.fromkeys(("position_mm", "heading_deg", "time_s"), math.inf) | {
            "clearance_m": -math.inf
        }
    last, goal = during[-1, 1:4], np.array(driven.goal)
    return {
        "position_mm": 1e3 * float(np.hypot(*(last[:2] - goal[:2]))),
        "heading_deg": math.degrees(abs(float(wrap_angle(last[2] - goal[2])))),
        "time_s": driven.interval.end - driven.interval.start,
        "clearance_m": float(driven.obstacles.gaps(during[:, :4], half_size).min()),
    }


class GoalLeg(Leg):
    """Drives to a goal by the planner, while obstacles cross the robot's path.

    Args:
        half_size: Half length and half width of the robot's bounding box [m].

    Attributes:
        driven: The goal, once it has been reached.
    """

    limits = (
        Limit("goal.position_mm", "goal position, mm", 40.0),
        Limit("goal.heading_deg", "goal heading, deg", 3.0),
        Limit("goal.clearance_m", "clearance of the obstacles, m", 0.0, Bound.ABOVE),
    )

    def __init__(self, half_size: Sequence[float]) -> None:
        self._half_size = tuple(half_size)
        self.driven: DrivenGoal | None = None

    def drive(self, driver: Driver) -> None:
        """Send goal and obstacles, and wait until the planner has arrived.

        Raises:
            CommandError: The goal was not reached in time.
        """
        driver.progress.begin("goal, obstacles")
        driver.wait_until_idle()
        start, robot = driver.now, driver.pose
        obstacles = MovingObstacles.in_front_of(robot, start)
        goal = to_odom(np.array([GOAL]), robot)[0]
        _observe(driver, obstacles)
        driver.robot.send_goal(goal)
        driver.recorder.planner.clear()
        self._wait_for_arrival(driver, obstacles, goal)
        x, y, theta = (float(value) for value in goal)
        interval = Interval("goal", start, driver.now)
        self.driven = DrivenGoal((x, y, theta), obstacles, interval)
        driver.robot.send_obstacles(obstacles.removal_message())
        driver.rest()
        driver.progress.end(driver.note)

    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return the errors at the goal, and the clearance, under `goal`."""
        if self.driven is None:
            return {}
        return {"goal": goal_figures(np.array(recording.odom), self.driven, self._half_size)}

    @staticmethod
    def _wait_for_arrival(driver: Driver, obstacles: MovingObstacles, goal: Array) -> None:
        """Send observations until the planner has driven and arrived.

        Raises:
            CommandError: The goal was not reached in time.
        """
        distance, has_driven, remaining = math.hypot(*GOAL[:2]), False, math.inf
        for _ in driver.ticks(GOAL_TIMEOUT, OBSERVATION_PERIOD):
            _observe(driver, obstacles)
            x, y, _ = driver.pose
            remaining = math.hypot(goal[0] - x, goal[1] - y)
            driver.progress.update(1.0 - remaining / distance, driver.note)
            state = driver.recorder.planner.get("state")
            has_driven = has_driven or state == "driving"
            if has_driven and state == "arrived":
                return
        reported = driver.recorder.planner.get("last", "nothing")
        raise CommandError(
            f"the goal was not reached, {remaining:.2f} m remain; mpc_planner reports: "
            f"{reported}{driver.recorder.recording.stall_note}"
        )


def _observe(driver: Driver, obstacles: MovingObstacles) -> None:
    """Send an observation of the obstacles at this moment."""
    now = driver.now
    stamp = Time(nanoseconds=round(1e9 * now)).to_msg()
    driver.robot.send_obstacles(obstacles.message(now, stamp))
