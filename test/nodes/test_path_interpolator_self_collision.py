"""Motions that would bring the arm against the robot, over real topics."""

import math

import numpy as np
import pytest

from omniman_ros.motion.path.interpolator import PathState
from test.nodes.harness import PERIOD
from test.nodes.test_path_interpolator_arm import HOME
from test.nodes.test_path_interpolator_tool import ToolWorld
from test.nodes.test_path_interpolator_whole_body import BODY, trajectory

#: Joint angles at which the forearm lies in the upper arm [rad]
FOLDED = [0.0, -0.5 * math.pi, 2.9, 0.0, 0.0, 0.0]


@pytest.fixture
def world():
    with ToolWorld() as made:
        yield made


def require_refusal(world, *words):
    """Require that the last input was refused with words in its warning, and nothing moves."""
    assert all(word in world.warnings[-1] for word in words), world.warnings
    world.run(5 * PERIOD)
    assert not world.references and not world.joint_previews
    assert world.arm.state is PathState.IDLE and world.node.motions.whole_body.idle


def test_a_trajectory_into_the_robot_is_refused_with_parts_and_time(world):
    world.move([FOLDED])
    require_refusal(world, "with itself", "mm deep in it", "s after the start")
    world.move([HOME])
    assert world.arm.state is PathState.FOLLOWING


def test_a_trajectory_into_the_robot_leaves_the_motion_under_way(world):
    world.move([HOME])
    world.move([FOLDED])
    assert "with itself" in world.warnings[-1]
    world.run_to_arm_end()
    assert world.joints == pytest.approx(HOME, abs=1e-6)


def test_a_trajectory_of_the_whole_body_into_the_robot_is_refused(world):
    world.trajectories.publish(trajectory([[0.5, 0.0, 0.0, *FOLDED]], names=BODY))
    world.run(2 * PERIOD)
    require_refusal(world, "with itself", "s after the start")


def test_a_tool_path_that_leads_below_the_margin_is_refused(world):
    down = [(0.05, 0.0, -0.1), (0.1, 0.0, -0.25)]
    world.set("self_collision.margin", 0.2)
    world.send_tool(down)
    world.wait_for_plan()
    require_refusal(world, "with itself", "within")
    world.set("self_collision.margin", 0.005)
    world.send_tool(down)
    world.run_to_motion_start()


def test_a_load_counts_from_the_moment_it_is_set(world):
    """What the empty hand may do is refused while it holds something large."""
    target = np.array([0.0, -1.9, 2.3, -1.97, -1.57, 0.0])
    world.set("load.length", 0.8)
    world.set("load.width", 0.8)
    world.set("load.height", 0.35)
    world.move([target])
    require_refusal(world, "load")
    world.set("load.length", 0.0)
    world.move([target])
    assert world.arm.state is PathState.FOLLOWING


def test_the_check_can_be_switched_off(world):
    world.set("self_collision.check", False)
    world.move([FOLDED])
    assert world.arm.state is PathState.FOLLOWING


def test_a_platform_that_carries_no_arm_is_not_checked():
    with ToolWorld({"arm.mass": 0.0}) as world:
        world.move([FOLDED])
        assert world.arm.state is PathState.FOLLOWING
