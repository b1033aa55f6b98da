"""Publishers of another type than the node reads, whose messages never arrive."""

from contextlib import contextmanager

import pytest
import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node
from sensor_msgs.msg import Image

from omniman_ros.nodes.platform_controller import PlatformControllerNode
from test.nodes.harness import World


@contextmanager
def stranger(world, kind, topic):
    """Publish a topic from another participant, as one cannot have it with two types."""
    context = rclpy.Context()
    context.init(domain_id=world.domain)
    node = Node("stranger", context=context)
    try:
        node.create_publisher(kind, topic, 10)
        graph = world.nodes[0].get_publishers_info_by_topic
        world._await(
            lambda: any(
                info.node_name == "stranger" and info.topic_type.endswith(f"/{kind.__name__}")
                for info in graph(topic)
            ),
            f"the publisher of {topic}",
        )
        yield
    finally:
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize(("stamped", "foreign"), [(False, TwistStamped), (True, Twist)])
def test_a_twist_of_the_other_type_is_named_once_with_the_parameter(capfd, stamped, foreign):
    with World(PlatformControllerNode, parameters={"cmd_vel_stamped": stamped}) as world:
        (node,) = world.nodes
        world.publisher(TwistStamped if stamped else Twist, "cmd_vel")
        world.run(1.1)
        assert not node.warning_counts, "what is read is no reason to warn"
        with stranger(world, foreign, "cmd_vel"):
            world.run(3.1)
        assert node.warning_counts == {"/cmd_vel type": 1}
        text = capfd.readouterr().err
        assert f"/cmd_vel: /stranger publishes geometry_msgs/msg/{foreign.__name__}, and" in text
        assert "the parameter cmd_vel_stamped selects the type" in text


def test_any_input_of_another_type_is_named():
    with World(PlatformControllerNode) as world:
        world.run(1.1)
        with stranger(world, Image, "wheel_states"):
            world.run(2.1)
        assert world.nodes[0].warning_counts == {"/wheel_states type": 1}
