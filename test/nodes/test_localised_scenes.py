"""Random scenes: goals in a map that drifts and jumps, obstacles in the frame of the robot.

The odometry is taken for the truth; what the localisation gets wrong is in map -> odom alone.
"""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from omniman_ros.core import se2
from omniman_ros.planning.cycle import PlannerState
from omniman_ros.planning.obstacles.separation import box_gap
from test.nodes.test_mpc_planner import (
    TrueObstacle,
    goal,
)
from test.nodes.test_planner_frames import LocalisedPlanner
from test.nodes.transforms import Pose, tf_installed
from test.tiers import exhaustive

SCENES = 60
DRIFT = 0.05 / 60.0
OBSTACLES = 3
APART = 1.2  #: Distance of all obstacles from start and goal [m], which jumps may make less
#: Gap at the goal below which it counts as occupied [m]: safety.clearance by default
CLEARANCE = 0.05


@pytest.fixture(autouse=True, scope="module")
def tf() -> Iterator[None]:
    with tf_installed():
        yield


class Scene(LocalisedPlanner):
    """A planner that sees obstacles from `base_link`."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        jumps: dict[float, Pose] = {
            time: (
                0.2,
                float(rng.uniform(-math.pi, math.pi)),
                math.radians(5.0) * rng.choice((-1, 1)),
            )
            for time in (1.0, 3.0)
        }
        super().__init__(DRIFT, jumps)
        way, turn = float(rng.uniform(2.5, 3.5)), float(rng.uniform(-math.pi, math.pi))
        self.target = [way * math.cos(turn), way * math.sin(turn), float(rng.uniform(-1, 1))]
        while len(self.obstacles_present) < OBSTACLES:
            x, y = rng.uniform(-1.0, 1.0, 2) + rng.uniform(0.3, 0.7) * np.array(self.target[:2])
            if min(math.hypot(x, y), math.dist((x, y), self.target[:2])) > APART:
                self.obstacles_present.append(TrueObstacle(x, y, float(rng.uniform(0.1, 0.25))))
        self.seen = True

    def gap_at_goal(self) -> float:
        """Return the gap that the robot would have at its goal [m]."""
        centers = np.array([[thing.origin for thing in self.obstacles_present]])
        axes = np.array([[(thing.radius, thing.radius) for thing in self.obstacles_present]])
        box, flat = self.core.footprint.platform, np.zeros(OBSTACLES)
        pose = self.core.goal.targets(np.array([self.time]))[0]
        return float(box_gap(pose, box, centers, axes, flat).min())

    def marks(self) -> list:
        """Return the obstacles as seen from the robot."""
        x, y, theta = self.true_pose().tolist()
        self.tf.send("odom", "base_link", x, y, theta)
        made = super().marks()
        for one, thing in zip(made, self.obstacles_present, strict=True):
            one.header.frame_id, one.header.stamp = "base_link", self.stamp()
            center = (*thing.place(self.time).tolist(), 0.0)
            seen = se2.compose(se2.inverse((x, y, theta)), center)
            one.pose.position.x, one.pose.position.y = seen[:2]
        return made


@pytest.mark.parametrize("seed", [0, *(exhaustive(seed) for seed in range(1, SCENES))])
def test_goals_in_a_map_that_drifts_and_jumps_are_reached_without_contact(seed):
    with Scene(seed) as world:
        world.run(0.2)
        there = world.to_map(*world.target)
        world.goals.publish(goal(*there, frame="map"))
        world.begin()
        ended = (PlannerState.ARRIVED, PlannerState.BLOCKED)
        world.run_until(lambda: world.state in ended, 60.0, "an end")
        assert world.gap > 0.0, "contact"
        if world.state is PlannerState.BLOCKED:  # a jump has put the goal beside an obstacle
            assert world.gap_at_goal() < CLEARANCE
            return
        distance, angle = world.error_in_map(there)
        assert distance < 0.03 and angle < 0.03
        world.assert_no_step()
        assert world.localisation.jumped == 2
