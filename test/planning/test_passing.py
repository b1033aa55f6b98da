import math

import numpy as np
import pytest

from omniman_ros.planning import passing
from omniman_ros.planning.cycle import MeasuredState
from omniman_ros.planning.effective_limits import EffectiveLimits
from omniman_ros.planning.goals import StateGoal
from test.planning.support import parameters

P = parameters()
LIMITS = EffectiveLimits(P)


def a_goal(x=3.0, y=0.0, theta=0.0, velocity=(0.4, 0.0, 0.0), arrival=None):
    return StateGoal(np.array([x, y, theta]), np.array(velocity, float), arrival)


def state(x=0.0, y=0.0, theta=0.0, twist=(0.0, 0.0, 0.0)):
    return np.array([x, y, theta, *twist], float)


def just(x, y=0.0, theta=0.0, twist=(0.4, 0.0, 0.0)):
    return MeasuredState(0.0, np.array([x, y, theta]), np.array(twist, float))


def test_passing_time_is_fixed_once_the_pose_is_within_reach():
    far = passing.scheduled(a_goal(30.0), state(), 10.0, 0.0, LIMITS)
    assert far.arrival is None
    near = passing.scheduled(a_goal(0.5), state(), 10.0, 0.0, LIMITS)
    assert near.arrival is not None and near.arrival > 10.5
    assert passing.scheduled(near, state(0.3), 10.5, 0.0, LIMITS) is near


def test_missed_pose_is_approached_again():
    due = a_goal(0.5, arrival=10.0)
    assert passing.scheduled(due, state(), 10.1, 0.0, LIMITS) is due
    again = passing.scheduled(due, state(), 10.3, 0.0, LIMITS)
    assert again.arrival is not None and again.arrival > 10.3 + 0.5


def test_passing_time_behind_a_wall_follows_the_route():
    assert passing.scheduled(a_goal(0.5), state(), 0.0, 5.0, LIMITS).arrival is None
    assert passing.scheduled(a_goal(0.5), state(), 0.0, 0.2, LIMITS).arrival is not None


def test_passing_time_grows_with_a_smaller_limit_scale():
    times = [
        passing.run_up(state(), a_goal(1.0), EffectiveLimits(P, fraction))
        for fraction in (1.0, 0.5, 0.25)
    ]
    assert times == sorted(times) and times[0] < times[-1]


@pytest.mark.parametrize("seed", range(20))
def test_run_up_allows_braking_and_accelerating(seed):
    random = np.random.default_rng(seed)
    start = state(*random.uniform(-1, 1, 3), twist=random.uniform(-0.3, 0.3, 3))
    goal = a_goal(*random.uniform(-2, 2, 2), velocity=(*random.uniform(-0.4, 0.4, 2), 0.0))
    lasts = passing.run_up(start, goal, LIMITS)
    assert P.horizon.step <= lasts <= passing.MAX_RUN_UP
    if lasts < passing.MAX_RUN_UP:
        # A longer run-up is enough too, up to the growth of the distance before the pose.
        rate = passing.RUN_UP_ACCELERATION * (1.0 - P.reserve) * P.limits.linear_acceleration
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
def test_pose_counts_as_passed_just_behind_the_pose_close_and_at_speed(measured, is_passed):
    assert passing.is_passed(a_goal(arrival=1.0), measured, P.arrival) is is_passed
    assert not passing.is_passed(a_goal(), measured, P.arrival), "not before its time was said"
