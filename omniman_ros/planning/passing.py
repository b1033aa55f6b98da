"""Timing of a pose that is passed at a velocity, and detection of the passing."""

import math

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.planning.cycle import AT_REST, MeasuredState
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import StateGoal
from omniman_ros.planning.parameters import Arrival

#: Factor on the acceleration limit with which the robot reaches the velocity of a pose [-]
RUN_UP_ACCELERATION = 0.7
MAX_RUN_UP = 10.0  #: Longest time to reach the velocity of a pose [s]
APPROACH_SPEED = 0.5  #: Factor on the speed limits at which the robot gets to the pose [-]
#: Time after the due time after which a pose that was not passed is scheduled again [s]
RESCHEDULE_DELAY = 0.2
#: Factor on the arrival tolerances for a pose that is passed at a velocity [-]
PASSING_TOLERANCE = 2.0
PASSING_WINDOW = 0.1  #: Time since the passing within which it is recognised [s]


def scheduled(
    goal: StateGoal, start: Array, due: float, remaining: float, limits: EffectiveLimits
) -> StateGoal:
    """Return the goal with the time at which it is to be passed, once it is within reach.

    An arrival time that it has is kept until it was missed. The plan begins at `due` [s] in the
    state `start` (6,); the rest of the route lasts for `remaining` [s] at the route's speeds.
    """
    if goal.arrival is not None and due < goal.arrival + RESCHEDULE_DELAY:
        return goal
    horizon = limits.parameters.horizon
    error = goal.pose - start[:3]
    speed, yaw_rate = (APPROACH_SPEED * limit for limit in limits.speeds)
    direct = max(math.hypot(error[0], error[1]) / speed, abs(float(error[2])) / yaw_rate)
    needed = max(direct, remaining / APPROACH_SPEED)
    if needed >= horizon.duration and goal.arrival is None:
        return goal
    return goal.arriving(due + max(needed, 0.5 * horizon.duration, run_up(start, goal, limits)))


def run_up(start: Array, goal: StateGoal, limits: EffectiveLimits) -> float:
    """Return the shortest time [s] to join the motion that passes a pose at its velocity.

    In the frame that moves with that motion, the robot has to cover its distance from the origin
    and come to rest there: it accelerates with RUN_UP_ACCELERATION of the limit for half of the
    time, and brakes for the other half.
    """
    rate = RUN_UP_ACCELERATION * limits.accelerations[0]
    velocity = se2.to_world(float(start[2]), start[3:])
    relative = (velocity - goal.velocity)[:2]
    times = np.arange(limits.parameters.horizon.step, MAX_RUN_UP, 0.1)[:, None]
    offset = start[:2] - goal.pose[:2] + times * (goal.velocity[:2] + 0.5 * relative)
    distance = np.hypot(offset[:, 0], offset[:, 1])
    slowing = 0.25 * times[:, 0] * math.hypot(relative[0], relative[1])
    enough = 0.25 * rate * times[:, 0] ** 2 >= distance + slowing
    return float(times[enough.argmax(), 0]) if enough.any() else MAX_RUN_UP


def is_passed(goal: StateGoal, measured: MeasuredState, tolerance: Arrival) -> bool:
    """Return whether the robot has just passed the pose, in the direction of its velocity."""
    speed = math.hypot(*goal.velocity[:2])
    if goal.arrival is None:
        return False
    x, y = (measured.pose - goal.pose)[:2].tolist()
    heading_error = abs(se2.wrap(float(measured.pose[2] - goal.pose[2])))
    if speed < AT_REST:
        return math.hypot(x, y) <= tolerance.position and heading_error <= tolerance.heading
    ux, uy = (goal.velocity[:2] / speed).tolist()
    ahead, lateral_error = x * ux + y * uy, abs(y * ux - x * uy)
    elapsed = max(ahead, 0.0) / speed
    heading_error -= abs(float(goal.velocity[2])) * elapsed
    vx, vy, _ = se2.to_world(float(measured.pose[2]), measured.twist).tolist()
    just_passed = -0.1 * tolerance.position <= ahead <= PASSING_WINDOW * speed
    close = (
        lateral_error <= PASSING_TOLERANCE * tolerance.position
        and heading_error <= PASSING_TOLERANCE * tolerance.heading
    )
    return bool(just_passed and close and vx * ux + vy * uy > 0.5 * speed)
