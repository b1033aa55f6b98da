"""Where the solids around the robot are at other times."""

import numpy as np
import pytest

from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot


def test_what_moves_is_ahead_of_its_place_by_its_age_and_what_stands_stays():
    walker = UprightObstacles.cylinder(1.0, 2.0, 0.25, (0.0, 1.8))
    around = ObstacleSnapshot(
        standing=UprightObstacles.cylinder(-1.0, 0.5, 0.1, (0.0, 1.2)),
        moving=MovingObstacles(walker, np.array([[0.5], [-1.0]])),
        growth=np.zeros(1),
    )
    placed = around.placed(np.array([0.0, 2.0]))
    assert placed.centre.shape == (2, 2, 2)
    assert placed.centre[:, 0] == pytest.approx(np.array([[-1.0, 1.0], [0.5, 2.0]]))
    assert placed.centre[:, 1] == pytest.approx(np.array([[-1.0, 2.0], [0.5, 0.0]]))
    assert placed.rounding == pytest.approx([0.1, 0.25])
