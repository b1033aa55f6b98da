import math

import numpy as np
import pytest

from omniman_ros.planning import passing
from omniman_ros.planning.cycle import Measured
from omniman_ros.planning.goals import StateGoal

from .support import parameters

P = parameters()


def a_goal(x=3.0, y=0.0, theta=0.0, velocity=(0.4, 0.0, 0.0), arrival=None):
    return StateGoal(np.array([x, y, theta]), np.array(velocity, float), arrival)


def state(x=0.0, y=0.0, theta=0.0, twist=(0.0, 0.0, 0.0)):
    return np.array([x, y, theta, *twist], float)


def just(x, y=0.0, theta=0.0, twist=(0.4, 0.0, 0.0)):
    return Measured(0.0, np.array([x, y, theta]), np.array(twist, float))


def test_the_time_is_said_once_the_pose_is_within_reach_and_then_stays():
    far = passing.planned(a_goal(30.0), state(), 10.0, 0.0, P, 1.0)
    assert far.arrival is None
    near = passing.planned(a_goal(0.5), state(), 10.0, 0.0, P, 1.0)
    assert near.arrival is not None and near.arrival > 10.5
    assert passing.planned(near, state(0.3), 10.5, 0.0, P, 1.0) is near


def test_a_pose_that_was_missed_is_tried_again():
    due = a_goal(0.5, arrival=10.0)
    assert passing.planned(due, state(), 10.1, 0.0, P, 1.0) is due
    again = passing.planned(due, state(), 10.3, 0.0, P, 1.0)
    assert again.arrival is not None and again.arrival > 10.3 + 0.5


def test_behind_a_wall_the_route_says_when():
    assert passing.planned(a_goal(0.5), state(), 0.0, 5.0, P, 1.0).arrival is None
    assert passing.planned(a_goal(0.5), state(), 0.0, 0.2, P, 1.0).arrival is not None


def test_with_a_smaller_share_of_the_limits_it_takes_longer():
    times = [passing.run_up(state(), a_goal(1.0), P, share) for share in (1.0, 0.5, 0.25)]
    assert times == sorted(times) and times[0] < times[-1]


@pytest.mark.parametrize("seed", range(20))
def test_the_run_up_is_enough_for_half_braking_half_speeding_up(seed):
    random = np.random.default_rng(seed)
    start = state(*random.uniform(-1, 1, 3), twist=random.uniform(-0.3, 0.3, 3))
    goal = a_goal(*random.uniform(-2, 2, 2), velocity=(*random.uniform(-0.4, 0.4, 2), 0.0))
    lasts = passing.run_up(start, goal, P, 1.0)
    assert P.horizon.step <= lasts <= passing.LONGEST_RUN_UP
    if lasts < passing.LONGEST_RUN_UP:
        # Longer is enough as well, up to what the way ahead of the pose grows by.
        rate = passing.RUN_UP * (1.0 - P.reserve) * P.limits.linear_acceleration
        c, s = math.cos(start[2]), math.sin(start[2])
        velocity = np.array([c * start[3] - s * start[4], s * start[3] + c * start[4]])
        relative = velocity - goal.velocity[:2]
        away = start[:2] - goal.pose[:2] + lasts * (goal.velocity[:2] + 0.5 * relative)
        assert 0.25 * rate * lasts**2 >= math.hypot(*away)


@pytest.mark.parametrize(
    ("measured", "is_passed"),
    [
        (just(3.01), True),
        (just(2.9), False),
        (just(3.2), False),
        (just(3.01, y=0.1), False),
        (just(3.01, theta=0.2), False),
        (just(3.01, twist=(-0.4, 0.0, 0.0)), False),
        (just(3.01, twist=(0.1, 0.0, 0.0)), False),
    ],
)
def test_passed_is_just_behind_it_close_and_at_speed(measured, is_passed):
    assert passing.passed(a_goal(arrival=1.0), measured, P.arrival) is is_passed
    assert not passing.passed(a_goal(), measured, P.arrival), "not before its time was said"
