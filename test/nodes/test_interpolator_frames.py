"""Paths in frames that move against odom."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from nav_msgs.msg import Path

from omniman_ros.conversions.poses import path_message
from omniman_ros.motion.path.interpolator import PathState
from test.nodes.test_path_interpolator import FakeControllerWorld
from test.nodes.test_path_interpolator_tool import ToolWorld
from test.nodes.transforms import Localisation, Pose, Transforms, tf_installed

START: Pose = (3.0, -1.0, 2.0)


@pytest.fixture(autouse=True, scope="module")
def tf() -> Iterator[None]:
    with tf_installed():
        yield


def test_a_path_in_map_is_driven_in_odom_where_map_was_when_it_came():
    with FakeControllerWorld() as world:
        localisation = Localisation(world, Transforms(world), START)
        world.run(0.05)
        there = [
            localisation.in_map(np.array(pose)) for pose in ((0.3, 0.0, 0.0), (0.3, 0.2, 0.4))
        ]
        world.send([tuple(pose) for pose in there], frame="map")
        world.run(0.2)
        assert world.core.state is PathState.FOLLOWING
        localisation.matrix = localisation.matrix @ Localisation._of(0.2, 0.1, math.radians(5.0))
        world.run_to_end()
        _, x, _, _ = world.assert_smooth()
        assert x[-1] == pytest.approx([0.3, 0.2, 0.4], abs=1e-9)
        assert world.warnings == []


def test_a_path_waits_for_its_transform_and_is_refused_without():
    with FakeControllerWorld() as world:
        transforms = Transforms(world)
        transforms.send("map", "odom", 1.0)
        world.run(0.02)
        world.send([(0.2, 0.0, 0.0)], frame="arena")
        world.run(0.1)
        assert world.core.state is PathState.IDLE and world.warnings == []
        transforms.send("map", "arena", 1.0, static=True)
        world.run(0.02)
        assert world.core.state is PathState.FOLLOWING
        world.run_to_end()
        world.send([(0.2, 0.0, 0.0)], frame="attic")
        world.run(0.4)
        assert "frame 'attic', expected 'odom'" in world.warnings[0]
        assert "frame 'attic'" in world.status(0.15).message


def test_poses_in_another_frame_than_their_path_are_refused():
    with FakeControllerWorld() as world:
        Transforms(world).send("map", "odom", 1.0)
        world.run(0.02)
        message = path_message(np.array([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]), "map")
        message.poses[1].header.frame_id = "odom"
        world.publisher(Path, "path").publish(message)
        world.run(0.05)
        assert "frame 'odom', expected 'map'" in world.warnings[0]


def test_a_tool_path_in_map_keeps_the_orientation_that_it_leaves_out():
    with ToolWorld() as world:
        localisation = Localisation(world, Transforms(world), START)
        world.run(0.05)
        tool = world.node.motions.tool
        message = path_message(np.array([[*localisation.in_map(np.zeros(3))[:2], 0.0]]), "map")
        message.poses[0].pose.orientation.w = 0.0
        message.poses[0].pose.position.z = 0.7
        place = world.node.motions.frames.into_odom(message.header).matrix()
        [pose] = tool._poses(message, place, np.eye(3))
        expected = np.eye(4)
        expected[2, 3] = 0.7
        assert pose == pytest.approx(expected, abs=1e-6)
