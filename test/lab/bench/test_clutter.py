import math

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.bench.clutter import (
    JACKAL_SIZE,
    ClutterRun,
    clutter_world,
    drive_clutter,
    shortest_length,
)
from omniman_ros.planning.parameters import PlannerParameters
from omniman_ros.robots import robot_parameters


@pytest.mark.parametrize(
    ("reached", "seconds", "expected"),
    [
        (True, 3.0, 0.5),
        (True, 10.0, 0.5),
        (True, 20.0, 0.25),
        (True, 99.0, 0.125),
        (False, 3.0, 0),
    ],
)
def test_the_score_counts_times_between_two_and_eight_best_times(reached, seconds, expected):
    assert ClutterRun(0, reached, (), seconds, 5.0).score == pytest.approx(expected)


def test_the_shortest_path_leads_around_posts():
    assert shortest_length(np.zeros((0, 2)), 0.3) == pytest.approx(10.0)
    post = np.array([[5.0, 0.0]])
    tangents = 2.0 * (math.sqrt(25.0 - 1.0) + math.asin(0.2))
    assert tangents < shortest_length(post, 1.0) < 1.03 * tangents
    wall = np.column_stack([np.full(31, 5.0), np.linspace(-2.25, 2.25, 31)])
    assert shortest_length(wall, 0.3) == math.inf


def test_a_world_follows_its_seed():
    robot = build(PlannerParameters, {**robot_parameters("ig42"), **JACKAL_SIZE}).robot
    first, again, other = (clutter_world(seed, robot) for seed in (2, 2, 3))
    assert first == again != other
    assert 5.0 <= first[1] < 6.0


@pytest.mark.exhaustive
@pytest.mark.parametrize("by_scanner", [False, True])
def test_a_robot_gets_through(by_scanner):
    pytest.importorskip("mujoco")
    robot = {**robot_parameters("ig42"), **JACKAL_SIZE}
    run = drive_clutter(robot, 2, by_scanner)
    assert run.reached
    assert not run.touched
    assert run.score > 0.45
