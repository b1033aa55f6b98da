"""Poses of `initialpose` put a simulated robot somewhere, whatever frame they are in."""

import math
from collections.abc import Iterator

import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped

from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from test.nodes.harness import World
from test.nodes.transforms import Transforms, tf_installed

WAIT = 0.3


class Placed(World):
    """A simulated robot, put somewhere by the test.

    Args:
        hears_tf: Whether tf2_msgs is installed.
    """

    def __init__(self, *, hears_tf: bool = True, **parameters: object) -> None:
        super().__init__(SimulatedDriveNode, parameters=parameters)
        self.node: SimulatedDriveNode = self.nodes[0]
        self.tf = Transforms(self) if hears_tf else None
        self._poses = self.publisher(PoseWithCovarianceStamped, "initialpose")

    def put(self, frame: str, x: float, *, age: float = 0.0, seconds: float = 0.02) -> None:
        """Send a pose on the x axis of a frame."""
        message = PoseWithCovarianceStamped()
        message.header.frame_id, message.header.stamp = frame, self.stamp(-age)
        message.pose.pose.position.x = x
        message.pose.pose.orientation.w = 1.0
        self._poses.publish(message)
        self.run(seconds)

    @property
    def pose(self) -> object:
        """True pose of the robot (x, y, heading), for comparisons."""
        return pytest.approx(self.node.drives.ground_truth()[0].tolist(), abs=1e-6)

    @property
    def warnings(self) -> int:
        """Number of poses that were refused."""
        return self.node.warning_counts.get("initialpose", 0)


@pytest.fixture
def robot() -> Iterator[Placed]:
    with tf_installed(), Placed() as made:
        yield made


def test_the_frame_is_transformed_into_the_world_at_the_stamp(robot):
    robot.tf.send("map", "odom", 1.0, 2.0, math.pi / 2, age=0.1)
    robot.tf.send("odom", "base_link", 0.5, static=True)
    robot.run(0.02)
    robot.tf.send("map", "odom", 3.0, 2.0, math.pi / 2, age=-0.1)
    robot.run(0.02)
    robot.put("map", 4.0, age=5.0)
    assert robot.pose == (4.0, 0.0, 0.0)
    robot.put("odom", 1.0)
    x, y, heading = robot.node.drives.ground_truth()[0]
    assert 1.8 < x < 2.5 and (y, heading) == pytest.approx((3.0, math.pi / 2))
    robot.put("base_link", 0.0)
    assert robot.node.drives.ground_truth()[0][1:] == pytest.approx((2.5, math.pi / 2))
    assert robot.warnings == 0


def test_a_pose_waits_for_its_transform_for_a_bounded_time(robot):
    robot.tf.send("map", "odom", 1.0)
    robot.run(0.02)
    robot.put("odom", 1.0, seconds=0.1)
    assert robot.pose == (0.0, 0.0, 0.0)
    robot.tf.send("map", "odom", 1.0)
    robot.run(0.05)
    assert robot.pose == (2.0, 0.0, 0.0)
    robot.put("odom", 5.0, seconds=WAIT + 0.1)
    assert robot.pose == (2.0, 0.0, 0.0) and robot.warnings == 1


def test_odom_is_the_world_as_long_as_nothing_relates_the_two(robot):
    robot.tf.send("odom", "base_link", 0.5)
    robot.put("odom", 3.0, seconds=WAIT + 0.1)
    assert robot.pose == (3.0, 0.0, 0.0)
    robot.put("camera", 9.0, seconds=WAIT + 0.1)
    assert robot.pose == (3.0, 0.0, 0.0) and robot.warnings == 1


@pytest.mark.parametrize("frame", ["world", "map", "/robot1/odom"])
def test_without_tf_the_frames_of_the_robot_are_one(frame):
    names = {"world_frame": "world", "odom_frame": "robot1/odom"}
    with Placed(hears_tf=False, **names) as robot:
        robot.put(frame, 2.0)
        assert robot.pose == (2.0, 0.0, 0.0)
        robot.put("odom", 9.0)
        assert robot.pose == (2.0, 0.0, 0.0) and robot.warnings == 1
