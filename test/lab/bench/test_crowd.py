import math
from itertools import count, islice, pairwise

import pytest

from omniman_ros.lab.bench.crowd import (
    BASELINES,
    GOAL_DISTANCE,
    GOAL_HALF,
    KINDS,
    drive_in_crowd,
    goal_poses,
)
from omniman_ros.robots import robot_parameters


def drive(kind, method, discs):
    """Drive for 20 s with a clock of which each reading is 4 ms after the last."""
    readings = count(step=0.004)
    timer = lambda: float(next(readings))  # noqa: E731 - a method reads it without arguments
    return drive_in_crowd(robot_parameters("ig42"), kind, method, 0, 20.0, discs, timer)


def test_goals_are_apart_within_their_square_and_repeat():
    poses = list(islice(goal_poses(3), 20))
    assert max(abs(pose[:2]).max() for pose in poses) <= GOAL_HALF
    assert min(math.dist(a[:2], b[:2]) for a, b in pairwise(poses)) >= GOAL_DISTANCE
    assert (poses[7] == list(islice(goal_poses(3), 20))[7]).all()


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", BASELINES)
def test_a_baseline_reaches_goals_among_few(kind, method):
    run = drive(kind, method, 4)
    assert run.goals > 0
    assert run.seconds == pytest.approx(20.0, abs=0.05)


@pytest.mark.exhaustive
@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_that_moves_touches_nobody(kind):
    run = drive(kind, "planner", 8)
    assert run.contacts == 0
    assert run.goals > 0
