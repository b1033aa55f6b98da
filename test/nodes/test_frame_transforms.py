"""Transforms of a node's input: what is received on /tf, and messages that wait for it."""

import math
from collections.abc import Iterator
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Header

from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import Transform
from omniman_ros.core.transform_tree import TransformError
from omniman_ros.nodes.frame_parameters import FrameParameters, OdomFrame, TransformOptions
from omniman_ros.nodes.frame_transforms import FrameTransforms
from omniman_ros.nodes.omniman_node import OmnimanNode
from test.nodes.harness import World
from test.nodes.transforms import Transforms, tf_installed

WAIT = 0.3


class Listener(OmnimanNode):
    """A node that places the poses it gets."""

    def __init__(self, *, map_is_odom: bool = False, **options: Any) -> None:
        super().__init__("listener", **options)
        self.options = FrameParameters(
            odom=OdomFrame(map_is_odom=map_is_odom), tf=TransformOptions(wait=WAIT)
        )
        self.frames = FrameTransforms(self, lambda: self.options)
        self.poses: list[tuple[float, ...]] = []
        self.warnings: list[str] = []
        handler = self.frames.deferred("pose", lambda message: [message.header], self.take)
        self.create_subscription(PoseStamped, "pose", self.guarded("pose", handler), 100)

    def take(self, message: PoseStamped) -> None:
        pose = Transform((message.pose.position.x, 0.0, 0.0))
        self.poses.append((self.frames.into_odom(message.header) @ pose).planar())

    def warn(self, subject: str, text: str) -> None:
        self.warnings.append(text)


class ListenerWorld(World):
    def __init__(self, **options: Any) -> None:
        super().__init__(lambda **given: Listener(**options, **given))
        self.node: Listener = self.nodes[0]
        self.tf = Transforms(self)
        self.sender = self.publisher(PoseStamped, "pose")
        self.run(0.01)

    def header(self, frame: str, age: float | None = 0.0) -> Header:
        return (
            Header(frame_id=frame)
            if age is None
            else Header(frame_id=frame, stamp=self.stamp(-age))
        )

    def send(self, frame: str, x: float = 0.0, age: float | None = 0.0) -> None:
        message = PoseStamped(header=self.header(frame, age))
        message.pose.position.x = x
        self.sender.publish(message)
        self.run(0.01)


@pytest.fixture(autouse=True, scope="module")
def tf() -> Iterator[None]:
    with tf_installed():
        yield


@pytest.fixture
def world() -> Iterator[ListenerWorld]:
    with ListenerWorld() as made:
        made.tf.send("odom", "base_link", 1.0, age=0.1)
        made.tf.send("base_link", "laser", 0.5, 0.0, math.pi / 2, static=True)
        made.run(0.02)
        yield made


def test_a_sensor_is_placed_where_it_was_at_the_stamp(world):
    world.tf.send("odom", "base_link", 2.0, age=-0.1)
    world.run(0.01)
    stamped = world.header("laser", age=0.03 + 0.0)
    found = world.node.frames.placement(stamped)
    assert found.frame == ""
    x, y, theta = found.transform.planar()
    assert 1.5 < x < 2.5 and (y, theta) == pytest.approx((0.0, math.pi / 2))
    earlier = world.node.frames.placement(world.header("laser", age=0.08)).transform.planar()[0]
    assert x - earlier == pytest.approx(0.05 / (0.2 + 0.02), abs=1e-3)


def test_what_is_fixed_in_the_world_is_placed_by_the_newest_transform(world):
    world.tf.send("map", "odom", 1.0, 0.0, 0.0, age=5.0)
    world.tf.send("map", "dock", 4.0, static=True)
    world.run(0.02)
    world.send("map", age=20.0)
    world.send("dock", age=20.0)
    world.tf.send("map", "odom", 2.0)
    world.run(0.02)
    world.send("dock", age=None)
    assert [pose[0] for pose in world.node.poses] == pytest.approx([-1.0, 3.0, 2.0])
    assert world.node.frames.placement(world.header("dock")).frame == "map"
    assert world.node.warnings == []


def test_a_message_waits_for_the_transform_at_its_stamp_and_its_turn(world):
    world.send("laser", x=1.0)
    world.send("odom", x=2.0)
    world.run(0.1)
    assert world.node.poses == []
    world.tf.send("odom", "base_link", 3.0)
    world.run(0.02)
    assert [len(world.node.poses), world.node.poses[1][0]] == [2, 2.0]
    assert world.node.warnings == []


def test_the_wait_is_bounded_and_its_end_names_the_frames(world):
    begin = world.time
    world.send("laser")
    world.run_until(lambda: bool(world.node.warnings), 1.0, "a warning")
    assert WAIT <= world.time - begin < WAIT + 0.1
    [warning] = world.node.warnings
    assert "frame 'laser', expected 'odom'" in warning
    assert "'base_link' to 'odom' is 0." in warning
    assert world.node.poses == []


def test_a_stamp_before_the_history_is_refused_at_once(world):
    world.send("laser", age=3.0)
    assert "begin 2.88" in world.node.warnings[0]


def test_bad_transforms_are_warned_of_and_the_others_of_the_message_count(world):
    world.tf.send("odom", "base_link", math.nan)
    world.tf.send("odom", "", 1.0)
    world.tf.send("odom", "shelf", 6.0)
    world.run(0.02)
    world.send("shelf", age=None)
    assert [len(world.node.warnings), world.node.poses[0][0]] == [2, 6.0]


def test_nothing_is_waited_for_where_there_is_no_transform_at_all():
    with ListenerWorld() as world:
        world.send("map")
        [warning] = world.node.warnings
        assert "frame 'map', expected 'odom'" in warning


def test_map_is_another_name_of_odom_by_parameter_whatever_tf_says():
    with ListenerWorld(map_is_odom=True) as world:
        world.tf.send("map", "odom", 5.0)
        world.run(0.02)
        world.send("map", x=1.0)
        assert world.node.poses == [(1.0, 0.0, 0.0)]


def test_transforms_are_forgotten_when_time_goes_back_but_not_where_the_map_was(world):
    world.tf.send("map", "odom", 1.0)
    world.run(0.02)
    frames = world.node.frames
    before = frames.anchor("map")
    world.time -= 100.0
    world.run(0.01)
    world.tf.send("odom", "base_link", 9.0)
    world.run(0.02)
    with pytest.raises(TransformError):
        frames.placement(world.header("map"))
    assert frames.anchor("map") == before
    assert frames.placement(world.header("laser", None)).transform.planar()[0] == 9.5


def test_a_silent_localisation_is_noticed(world):
    frames, timeout = world.node.frames, world.node.options.tf.timeout
    world.tf.send("map", "odom", 1.0)
    world.tf.send("earth", "map", 1.0, static=True)
    world.run(0.02)
    assert frames.silence_reason("map") == "" == frames.silence_reason("")
    world.run(timeout)
    assert "'map' to 'odom' is 2.0 s old" in frames.silence_reason("map")
    assert frames.silence_reason("earth")


def test_a_transform_far_ahead_is_refused_and_hides_neither_the_next_nor_their_end(world):
    frames, timeout = world.node.frames, world.node.options.tf.timeout
    world.tf.send("map", "odom", 1.0)
    world.tf.send("map", "odom", 9.0, age=-3600.0)
    world.run(0.02)
    [warning] = world.node.warnings
    assert "/tf ignored: 'odom' in 'map': the stamp is 3599.99" in warning
    world.tf.send("map", "odom", 2.0, age=-1.0)  # as a localisation dates them
    world.run(0.02)
    assert frames.anchor("map").planar()[0] == -2.0
    world.run(timeout)
    assert "'map' to 'odom' is 2.0 s old" in frames.silence_reason("map")


def test_a_message_stamped_far_ahead_is_refused_at_once_in_any_frame(world):
    for count, frame in enumerate(("odom", "laser"), start=1):
        world.send(frame, age=-3600.0)
        assert len(world.node.warnings) == count
        assert "the stamp is 3599.99" in world.node.warnings[-1]
    assert world.node.poses == []


def test_a_localisation_that_ends_as_time_goes_back_is_noticed(world):
    world.tf.send("map", "odom", 1.0)
    world.run(0.02)
    assert world.node.frames.silence_reason("map") == ""
    world.time -= 100.0
    world.run(0.01)
    assert "no transform of frame 'map'" in world.node.frames.silence_reason("map")


def test_a_tilted_frame_has_no_place_on_the_floor(world):
    frame = world.node.frames
    world.tf.send("odom", "lamp", 0.0)
    world.run(0.02)
    frame._tree.insert(
        "odom", "lamp", world.time, Transform(rotation=(0.1, 0.0, 0.0, 0.995)), is_static=True
    )
    with pytest.raises(InputError, match="not about the vertical"):
        frame.into_odom(world.header("lamp")).planar()
