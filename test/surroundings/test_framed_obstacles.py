"""Obstacles that are observed in several frames, which move against each other."""

import math

import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.surroundings.framed_obstacles import ODOM, FramedObstacles
from omniman_ros.surroundings.obstacles import Observation, ObstacleParameters

PERIOD = 0.05


class Moving:
    """Obstacles, and frames that a test moves."""

    def __init__(self, **values):
        self.obstacles = FramedObstacles(build(ObstacleParameters, values))
        self.frames = {ODOM: (0.0, 0.0, 0.0), "map": (0.0, 0.0, 0.0)}
        self.now = 10.0

    def add(self, frame, x, y=0.0, number=0, angle=0.0):
        self.obstacles.add(
            Observation(("a", number), self.now, x, y, angle, (0.3, 0.2), frame=frame), self.now
        )

    def ellipses(self):
        return self.obstacles.ellipses(self.now, self.frames.__getitem__)


@pytest.fixture
def moving():
    return Moving()


def test_obstacles_are_where_their_frame_is(moving):
    moving.add("map", 2.0, 1.0, angle=0.3)
    moving.add(ODOM, 5.0, number=1)
    moving.frames["map"] = (1.0, 0.0, math.pi / 2)
    found = moving.ellipses()
    assert found.centers == pytest.approx(np.array([[5.0, 0.0], [0.0, 2.0]]))
    assert found.angles == pytest.approx([0.0, 0.3 + math.pi / 2])
    assert moving.obstacles.keys == (("a", 1), ("a", 0)) and len(moving.obstacles) == 2


def test_a_jump_of_the_frame_is_no_velocity(moving):
    for i in range(60):
        moving.add("map", 2.0)
        if i == 30:
            moving.frames["map"] = (0.2, 0.0, 0.1)
        found = moving.ellipses()
        assert np.hypot(*found.velocities[0]) < 1e-9
        moving.now += PERIOD
    assert found.centers[0] == pytest.approx([0.2 + 2 * math.cos(0.1), 2 * math.sin(0.1)])


def test_the_velocity_turns_with_the_frame(moving):
    moving.frames["map"] = (0.0, 0.0, math.pi / 2)
    for i in range(60):
        moving.add("map", 0.5 * PERIOD * i)
        found = moving.ellipses()
        moving.now += PERIOD
    assert found.velocities[0] == pytest.approx([0.0, 0.5], abs=0.02)


def test_an_obstacle_is_in_the_frame_of_its_last_observation(moving):
    moving.add("map", 2.0)
    moving.add(ODOM, 3.0)
    assert moving.ellipses().centers[:, 0] == pytest.approx([3.0])
    moving.add("map", 4.0)
    assert moving.ellipses().centers[:, 0] == pytest.approx([4.0])


def test_deletions_concern_all_frames(moving):
    for number, frame in enumerate(("map", ODOM)):
        moving.add(frame, 2.0, number=number)
    moving.obstacles.delete(("a", 0))
    assert moving.obstacles.keys == (("a", 1),)
    moving.add("map", 2.0)
    moving.obstacles.delete_all("a")
    assert len(moving.obstacles) == 0


def test_obstacles_of_a_frame_without_a_place_are_an_error(moving):
    moving.add("moon", 2.0)
    with pytest.raises(KeyError):
        moving.ellipses()
