"""Transforms that the nodes publish: which, and in which namespace."""

from collections.abc import Iterator
from functools import partial

import pytest

from omniman_ros.nodes import tf_messages
from omniman_ros.nodes.collision_monitor import CollisionMonitorNode
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.processes.robot_setup import TRANSFORM_REMAPPING
from test.nodes.harness import World
from test.nodes.transforms import tf_installed

NAMESPACE = ["--ros-args", "-r", "__ns:=/robot1"]
TOPICS = {tf_messages.TOPIC, tf_messages.STATIC_TOPIC}


@pytest.fixture(autouse=True, scope="module")
def tf() -> Iterator[None]:
    with tf_installed():
        yield


def controller(**parameters: object) -> World:
    return World(PlatformControllerNode, parameters={"robot": "ig42"} | parameters)


def test_map_and_odom_are_published_as_one_where_they_are():
    with controller(map_is_odom=True, odom_frame="start") as world:
        [message] = world.listen(
            tf_messages.TFMessage, tf_messages.STATIC_TOPIC, tf_messages.STATIC_LISTENER
        )
        [same] = message.transforms
        assert (same.header.frame_id, same.child_frame_id) == ("map", "start")
        assert (same.transform.rotation.w, same.transform.translation.x) == (1.0, 0.0)


@pytest.mark.parametrize(
    "parameters", [{}, {"map_is_odom": True, "publish_tf": False}], ids=["apart", "without tf"]
)
def test_map_to_odom_is_left_to_a_localisation_otherwise(parameters):
    with controller(**parameters) as world:
        [node] = world.nodes
        assert tf_messages.STATIC_TOPIC not in {p.topic_name for p in node.publishers}


@pytest.mark.parametrize(
    ("remapping", "prefix"),
    [([], ""), ([*TRANSFORM_REMAPPING], "/robot1")],
    ids=["as is", "remapped"],
)
def test_transforms_are_global_in_a_namespace_unless_remapped(remapping, prefix):
    made = [
        partial(kind, cli_args=[*NAMESPACE, *remapping])
        for kind in (PlatformControllerNode, CollisionMonitorNode)
    ]
    with World(*made, parameters={"robot": "ig42", "map_is_odom": True}) as world:
        publisher, listener = world.nodes
        heard = {s.topic_name for s in listener.subscriptions if "/tf" in s.topic_name}
        sent = {p.topic_name for p in publisher.publishers if "/tf" in p.topic_name}
        assert sent == heard == {prefix + topic for topic in TOPICS}
