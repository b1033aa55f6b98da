"""Planner whose goals, obstacles and maps are in frames that move against odom."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.parameter import Parameter
from visualization_msgs.msg import MarkerArray

from omniman_ros.core import se2
from omniman_ros.nodes.motion_log import MotionEvent
from omniman_ros.nodes.stop_interface import LATCHED
from omniman_ros.planning.cycle import PlannerState
from test.nodes.test_mpc_planner import (
    TICK,
    PlannerWithFakeController,
    goal,
    goal_state,
    marker,
)
from test.nodes.transforms import Localisation, Pose, Transforms, tf_installed

START: Pose = (3.0, -1.0, 2.0)
JUMP: Pose = (0.2, 1.0, math.radians(5.0))


@pytest.fixture(autouse=True, scope="module")
def tf() -> Iterator[None]:
    with tf_installed():
        yield


class LocalisedPlanner(PlannerWithFakeController):
    """A planner in a world with a localisation."""

    def __init__(self, drift: float = 0.0, jumps: dict[float, Pose] | None = None) -> None:
        super().__init__()
        self.velocities: list[np.ndarray] = []
        self.tf = Transforms(self)
        self.localisation = Localisation(self, self.tf, START, drift, jumps)
        self.hooks.append(self._look_around)
        self.run(0.05)

    def _look_around(self) -> None:
        self.localisation.center = self.setpoint.pose[:2]
        self.velocities.append(self.setpoint.velocity)

    def to_map(self, *pose: float) -> list[float]:
        return self.localisation.in_map(np.array(pose)).tolist()

    def error_in_map(self, pose: list[float]) -> tuple[float, float]:
        error = self.localisation.in_map(self.true_pose()) - np.array(pose)
        return float(np.hypot(*error[:2])), abs(se2.wrap(float(error[2])))

    def assert_no_step(self) -> None:
        limits, steps = self.core.parameters.limits, np.abs(np.diff(self.velocities, axis=0))
        linear = max(limits.linear_acceleration, limits.linear_deceleration)
        angular = max(limits.angular_acceleration, limits.angular_deceleration)
        assert np.hypot(*steps[:, :2].T).max() <= 1.05 * linear * TICK, "the velocity jumps"
        assert steps[:, 2].max() <= 1.05 * angular * TICK, "the yaw rate jumps"


def test_a_goal_in_map_is_reached_there_while_the_localisation_drifts_and_jumps():
    jumps = {0.5: JUMP, 1.0: (0.2, -1.0, math.radians(5.0))}
    with LocalisedPlanner(drift=0.05 / 60.0, jumps=jumps) as world:
        there = world.to_map(1.0, 0.3, 0.3)
        world.goals.publish(goal(*there, frame="map"))
        world.begin()
        world.arrive(20.0)
        assert world.localisation.jumped == 2
        distance, angle = world.error_in_map(there)
        assert distance < 0.03 and angle < 0.03
        assert abs(world.true_pose()[:2] - [1.0, 0.3]).max() > 0.05, "the jumps did not matter"
        world.assert_no_step()
        assert world.warnings == []


def test_a_pose_to_pass_at_a_velocity_turns_with_its_frame():
    with LocalisedPlanner() as world:
        there = world.to_map(1.5, 0.0, 0.0)
        world.publisher(type(goal_state((0, 0, 0), (0, 0, 0))), "goal_state").publish(
            goal_state(there, (0.3, 0.0, 0.0), "map")
        )
        world.begin()
        final = world.core.goal
        assert final is not None
        assert final.pose == pytest.approx([1.5, 0.0, 0.0], abs=1e-6)
        assert final.velocity == pytest.approx([0.3, 0.0, 0.0], abs=1e-6)
        world.run(0.3)
        world.localisation.matrix = world.localisation._of(0.0, 0.0, -math.pi / 2)
        world.run(0.2)
        # The heading 2.0 in map is 2.0 + pi / 2 in odom now.
        assert world.core.goal.velocity == pytest.approx(
            [-0.3 * math.sin(2.0), 0.3 * math.cos(2.0), 0.0], abs=1e-6
        )


def test_a_twist_of_a_goal_in_another_frame_than_its_pose_is_refused():
    with LocalisedPlanner() as world:
        message = goal_state((1.0, 0.0, 0.0), (0.3, 0.0, 0.0), "map", "odom")
        world.publisher(type(message), "goal_state").publish(message)
        world.run(0.05)
        assert "twist is in 'odom', its pose in 'map'" in world.warnings[0]


def test_a_goal_in_base_link_is_where_the_robot_was_at_its_stamp():
    with LocalisedPlanner() as world:
        world.tf.send("odom", "base_link", 1.0, 0.0, age=0.2)
        world.tf.send("odom", "base_link", 2.0, 0.0)
        world.run(0.02)
        message = goal(0.5, 0.25, frame="base_link")
        message.header.stamp = world.stamp(-0.12)
        world.goals.publish(message)
        world.begin()
        pose = world.core.goal.targets(np.zeros(1))[0][0]
        assert pose == pytest.approx([2.0, 0.25, 0.0], abs=0.03)


def test_obstacles_and_maps_in_map_move_with_it_and_do_not_seem_to_drive():
    with LocalisedPlanner() as world:
        grid = OccupancyGrid(data=[100])
        grid.header.frame_id = "map"
        grid.info.width = grid.info.height = 1
        grid.info.resolution = 0.1
        corner = world.to_map(-2.0, 1.0, 0.0)
        grid.info.origin.position.x, grid.info.origin.position.y = corner[:2]
        grid.info.origin.orientation = goal(*corner).pose.orientation
        world.publisher(OccupancyGrid, "map", LATCHED).publish(grid)
        x, y, _ = world.to_map(3.0, 2.0, 0.0)
        for i in range(40):
            if i == 20:
                world.localisation.matrix = world.localisation.matrix @ Localisation._of(
                    -0.2, 0.0, 0.0
                )
            world.markers.publish(MarkerArray(markers=[marker(x, y, frame="map")]))
            world.run(0.05)
        found = world.node.inputs.surroundings.obstacles.ellipses()
        assert found.centers[0] == pytest.approx([3.2, 2.0], abs=1e-6)
        assert np.hypot(*found.velocities[0]) < 1e-6
        assert world.core.grid.origin == pytest.approx([-1.8, 1.0, 0.0], abs=1e-6)


def test_the_robot_waits_for_a_localisation_that_is_silent():
    with LocalisedPlanner() as world:
        there = world.to_map(2.0, 0.0, 0.0)
        world.goals.publish(goal(*there, frame="map"))
        world.begin()
        world.localisation.is_silent = True
        world.node.set_parameters([Parameter("tf.timeout", value=0.5)])
        world.run(0.7)
        world.rest()
        assert "waits: 'map' to 'odom' is 0." in world.last_status()[1]
        assert world.state is PlannerState.DRIVING and world.since_start() < 1.9
        world.localisation.is_silent = False
        world.run_until(lambda: world.true_speed() > 0.05, 2.0, "the robot to drive on")


def test_a_goal_in_an_unknown_frame_is_refused_after_the_wait():
    with LocalisedPlanner() as world:
        world.goals.publish(goal(1.0, 0.0, frame="moon"))
        world.run(0.2)
        assert world.warnings == [] and world.core.goal is None
        world.run(0.2)
        assert "frame 'moon', expected 'odom'" in world.warnings[0]
        assert world.node.loop.goals.counts[MotionEvent.REFUSED] == 1


def test_a_goal_that_waits_for_its_frame_can_be_cancelled():
    with LocalisedPlanner() as world:
        world.goals.publish(goal(1.0, 0.0, frame="moon"))
        world.run(0.1)
        assert world.call_service("cancel").success
        assert world.node.loop.goals.counts[MotionEvent.CANCELLED] == 1
        assert not world.call_service("cancel").success
        world.tf.send("odom", "moon", 0.0, 0.0, static=True)
        world.run(0.4)
        assert world.core.goal is None and not world.warnings


def test_a_goal_whose_frame_is_known_too_late_does_not_replace_a_newer_one():
    with LocalisedPlanner() as world:
        world.goals.publish(goal(1.0, 0.0, frame="moon"))
        states = world.publisher(Odometry, "goal_state")
        states.publish(goal_state((2.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
        world.run(0.1)
        newer = world.node.loop.goals.driven
        world.tf.send("odom", "moon", 0.0, 0.0, static=True)
        world.run(0.2)
        assert any("a newer goal came" in text for text in world.warnings), world.warnings
        assert world.node.loop.goals.driven is newer is not None
