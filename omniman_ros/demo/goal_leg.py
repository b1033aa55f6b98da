"""The leg of the demo that drives to a goal among obstacles, which cross its path."""

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.time import Time

from omniman_ros.console.errors import CommandError
from omniman_ros.core.arrays import Array
from omniman_ros.core.planar import Triple
from omniman_ros.demo.driver import Driver
from omniman_ros.demo.interval import Interval
from omniman_ros.demo.leg import Leg
from omniman_ros.demo.limits import Bound, Limit
from omniman_ros.demo.moving_obstacles import MovingObstacles, ObstaclesOverTime
from omniman_ros.demo.path_leg import to_odom
from omniman_ros.demo.perception_recorder import People, Perception
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
        perception: What the robot perceived, if it drove by its scanner.
    """

    goal: Triple
    obstacles: ObstaclesOverTime
    interval: Interval
    perception: Perception | None = None


def goal_figures(
    odom: Array, truth: Array, driven: DrivenGoal, half_size: Sequence[float]
) -> dict[str, Any]:
    """Return the error at the goal and the smallest clearance of the obstacles on the way, if any.

    Args:
        odom: Rows (k, 7) of `Recording.odom`.
        truth: Rows (k, 4) with the robot's pose in the frame of the obstacles, as in
            `Recording.truth`.
        driven: The goal in odom, and its obstacles.
        half_size: Half length and half width of the robot's bounding box [m].
    """
    during = odom[driven.interval.contains(odom[:, 0])]
    near = truth[driven.interval.contains(truth[:, 0])]
    if not len(during) or not len(near):
        return dict.fromkeys(("position_mm", "heading_deg", "time_s"), math.inf) | {
            "clearance_m": -math.inf
        }
    gaps = driven.obstacles.gaps(near, half_size) if len(driven.obstacles.radii) else None
    clearance = {} if gaps is None else {"clearance_m": float(gaps.min())}
    last, goal = during[-1, 1:4], np.array(driven.goal)
    return {
        "position_mm": 1e3 * float(np.hypot(*(last[:2] - goal[:2]))),
        "heading_deg": math.degrees(abs(float(wrap_angle(last[2] - goal[2])))),
        "time_s": driven.interval.end - driven.interval.start,
    } | clearance


class GoalLeg(Leg):
    """Drives to a goal by the planner, while obstacles cross the robot's path.

    Args:
        half_size: Half length and half width of the robot's bounding box [m].
        by_scanner: Whether the robot sees the persons of a world by its scanner; else it is told
            of obstacles that nobody else knows.

    Attributes:
        driven: The goal, once it has been reached.
    """

    limits = (
        Limit("goal.position_mm", "goal position, mm", 40.0),
        Limit("goal.heading_deg", "goal heading, deg", 3.0),
        Limit("goal.clearance_m", "clearance of the obstacles, m", 0.0, Bound.ABOVE),
    )

    def __init__(self, half_size: Sequence[float], *, by_scanner: bool = False) -> None:
        self._half_size = tuple(half_size)
        self._by_scanner = by_scanner
        self.driven: DrivenGoal | None = None

    def drive(self, driver: Driver) -> None:
        """Send goal and obstacles, and wait until the planner has arrived.

        Raises:
            CommandError: The goal was not reached in time.
        """
        driver.progress.begin("goal, obstacles")
        driver.wait_until_idle()
        start, robot = driver.now, driver.pose
        goal = to_odom(np.array([GOAL]), robot)[0]
        drive = self._drive_by_scanner if self._by_scanner else self._drive_among_told
        self.driven = drive(driver, goal, start)
        driver.rest()
        driver.progress.end(driver.note)

    def _drive_among_told(self, driver: Driver, goal: Array, start: float) -> DrivenGoal:
        """Drive among obstacles that the robot is told of."""
        obstacles = MovingObstacles.in_front_of(driver.pose, start)
        _observe(driver, obstacles)
        self._drive_to(driver, goal, lambda: _observe(driver, obstacles))
        driver.robot.send_obstacles(obstacles.removal_message())
        return DrivenGoal(_triple(goal), obstacles, Interval("goal", start, driver.now))

    def _drive_by_scanner(self, driver: Driver, goal: Array, start: float) -> DrivenGoal:
        """Drive among persons whom the robot sees."""
        with closing(driver.record_perception()) as recorder:
            self._drive_to(driver, goal, lambda: None)
        perception = recorder.perception
        nobody = [(start, np.zeros((0, 3)))]
        interval = Interval("goal", start, driver.now)
        people = People(perception.people or nobody)
        return DrivenGoal(_triple(goal), people, interval, perception)

    def measure(self, recording: Recording) -> dict[str, Any]:
        """Return the errors at the goal, and the clearance, under `goal`."""
        if self.driven is None:
            return {}
        odom = np.array(recording.odom)
        truth = np.array(recording.truth) if self._by_scanner else odom[:, :4]
        return {"goal": goal_figures(odom, truth, self.driven, self._half_size)}

    @staticmethod
    def _drive_to(driver: Driver, goal: Array, observe: Callable[[], None]) -> None:
        """Send the goal, then observations until the planner has driven and arrived.

        Raises:
            CommandError: The goal was not reached in time.
        """
        driver.robot.send_goal(goal)
        driver.recorder.planner.clear()
        distance, has_driven, remaining = math.hypot(*GOAL[:2]), False, math.inf
        for _ in driver.ticks(GOAL_TIMEOUT, OBSERVATION_PERIOD):
            observe()
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


def _triple(pose: Array) -> Triple:
    x, y, theta = (float(value) for value in pose)
    return x, y, theta


def _observe(driver: Driver, obstacles: MovingObstacles) -> None:
    """Send an observation of the obstacles at this moment."""
    now = driver.now
    stamp = Time(nanoseconds=round(1e9 * now)).to_msg()
    driver.robot.send_obstacles(obstacles.message(now, stamp))
