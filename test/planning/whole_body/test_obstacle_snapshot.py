"""Where the solids around the robot are at other times."""

import numpy as np
import pytest

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.parameters import build
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.surroundings.obstacles import Observation, ObstacleParameters, ObstacleSet


def test_what_moves_is_ahead_of_its_place_by_its_age_and_what_stands_stays():
    walker = UprightObstacles.cylinder(1.0, 2.0, 0.25, (0.0, 1.8))
    around = ObstacleSnapshot(
        standing=UprightObstacles.cylinder(-1.0, 0.5, 0.1, (0.0, 1.2)),
        moving=MovingObstacles(walker, np.array([[0.5], [-1.0]])),
        growth=np.zeros(1),
    )
    placed = around.placed(np.array([0.0, 2.0]), np.array([[0, 1], [1, 0]]))
    assert placed.centre.shape == (2, 2, 2)
    assert placed.centre[:, 0] == pytest.approx(np.array([[-1.0, 1.0], [0.5, 2.0]]))
    assert placed.centre[:, 1] == pytest.approx(np.array([[2.0, -1.0], [0.0, 0.5]]))
    assert placed.rounding == pytest.approx(np.array([[0.1, 0.25], [0.25, 0.1]]))


def observed(velocity, noise, count):
    """Return what is known after each of many noisy observations of one obstacle at 10 Hz."""
    known, random = ObstacleSet(build(ObstacleParameters, {})), np.random.default_rng(4)
    snapshots = []
    for k in range(count):
        now = 0.1 * k
        x, y = (now * np.array(velocity) + noise * random.standard_normal(2)).tolist()
        known.add(Observation(("post", 0), now, x, y, 0.0, (0.1, 0.1)), now)
        snapshots.append(ObstacleSnapshot.of_ellipses(now, known.ellipses(now), ["a post"]))
    return snapshots


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_noise_does_not_make_a_post_move(noise):
    snapshots = observed((0.0, 0.0), noise, 200)
    assert sum(len(each.moving) for each in snapshots) <= 4
    assert all(each.labels() == ("a post",) for each in snapshots)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_person_moves_from_the_fourth_observation_on(noise):
    snapshots = observed((0.3, 0.4), noise, 50)
    assert all(len(each.moving) == 1 for each in snapshots[3:])
    assert snapshots[-1].moving.velocity[:, 0] == pytest.approx([0.3, 0.4], abs=0.05)
