"""A pose that is passed at a velocity: when, and whether the robot has just done so."""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import se2
from omniman_ros.planning.cycle import Measured
from omniman_ros.planning.goals import StateGoal
from omniman_ros.planning.parameters import Arrival, PlannerParameters

Array = NDArray[np.float64]

RUN_UP, LONGEST_RUN_UP = 0.7, 10.0
"""Share of the acceleration and longest time [s] to get up to a velocity that is to be passed."""
UNHURRIED = 0.5
"""Share of the speeds at which the robot gets there."""
MISSED = 0.2
"""A pose that was not passed so long after it was due is tried again [s]."""
PASSING, JUST = 2.0, 0.1
"""A pose that is passed may be off by so many times what one to rest at may; since when [s]."""
AT_REST = 0.02
"""A velocity below this is none [m/s]."""


def planned(
    goal: StateGoal, start: Array, due: float, left: float, p: PlannerParameters, share: float
) -> StateGoal:
    """The goal with the time at which it is to be passed, once it is within reach.

    Args:
        goal: The goal; a time that it has stays until it was missed.
        start: (6,) state where the next plan begins: pose in odom, body twist.
        due: When that is [s].
        left: What is left of the route there, at its speeds [s].
        p: Parameters.
        share: Of the limits that is left.
    """
    if goal.arrival is not None and due < goal.arrival + MISSED:
        return goal
    error = goal.pose - start[:3]
    speed, turning = (UNHURRIED * fastest for fastest in p.speeds(share))
    straight = max(math.hypot(error[0], error[1]) / speed, abs(float(error[2])) / turning)
    needed = max(straight, left / UNHURRIED)
    if needed >= p.horizon.duration and goal.arrival is None:
        return goal
    return goal.arriving(
        due + max(needed, 0.5 * p.horizon.duration, run_up(start, goal, p, share))
    )


def run_up(start: Array, goal: StateGoal, p: PlannerParameters, share: float) -> float:
    """Least time [s] to get onto the line that passes a pose at its velocity.

    Seen from what moves along that line, the robot is away from its place by what the line is
    ahead, and has to come to rest there: with RUN_UP of the acceleration, half of the time
    speeding up and half of it braking.
    """
    rate = RUN_UP * (1.0 - p.reserve) * p.limits.linear_acceleration * share
    velocity = se2.to_world(float(start[2]), start[3:])
    relative = (velocity - goal.velocity)[:2]
    times = np.arange(p.horizon.step, LONGEST_RUN_UP, 0.1)[:, None]
    away = start[:2] - goal.pose[:2] + times * (goal.velocity[:2] + 0.5 * relative)
    distance = np.hypot(away[:, 0], away[:, 1])
    slowing = 0.25 * times[:, 0] * math.hypot(relative[0], relative[1])
    enough = 0.25 * rate * times[:, 0] ** 2 >= distance + slowing
    return float(times[enough.argmax(), 0]) if enough.any() else LONGEST_RUN_UP


def passed(goal: StateGoal, measured: Measured, tolerance: Arrival) -> bool:
    """Whether the robot has just gone through the pose, in the direction of its velocity."""
    speed = math.hypot(*goal.velocity[:2])
    if goal.arrival is None:
        return False
    x, y = (measured.pose - goal.pose)[:2].tolist()
    turned = abs(se2.wrap(float(measured.pose[2] - goal.pose[2])))
    if speed < AT_REST:
        return math.hypot(x, y) <= tolerance.position and turned <= tolerance.heading
    ux, uy = (goal.velocity[:2] / speed).tolist()
    ahead, aside = x * ux + y * uy, abs(y * ux - x * uy)
    since = max(ahead, 0.0) / speed
    turned -= abs(float(goal.velocity[2])) * since
    vx, vy, _ = se2.to_world(float(measured.pose[2]), measured.twist).tolist()
    behind_it = -0.1 * tolerance.position <= ahead <= JUST * speed
    close = aside <= PASSING * tolerance.position and turned <= PASSING * tolerance.heading
    return bool(behind_it and close and vx * ux + vy * uy > 0.5 * speed)
