"""Random messages on every topic that a node subscribes to, as an executor hands them over."""

import importlib
import math

import pytest
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message

from omniman_ros.core.arm_parameters import UR_JOINTS
from omniman_ros.nodes.rclpy_compat import deliver
from omniman_ros.nodes.registry import NODES, node_module
from omniman_ros.robots import robot_parameters
from test.fuzz import examples
from test.nodes.harness import World
from test.nodes.random_messages import RandomMessages
from test.nodes.test_documented_interfaces import parameters_of
from test.tiers import representative

WHEELS = list(robot_parameters("omniman")["wheels.names"])
WORDS = [*WHEELS, *UR_JOINTS, "platform", "odom", "map", "base_link", "arm"]
COMMANDS = ("wheel_commands", "wheel_voltages", "arm/joint_reference", "path/reference")
COMMANDS += ("mpc/reference", "mpc/voltages", "motion_limit", "odom")
#: Topics that are fed in the second half only, as nothing moves afterwards
STOPS = ("emergency_stop", "stop_state")
#: Nodes that are fed, the one of the suite first; the page is tested with a browser
FED = sorted(set(NODES) - {"viewer"}, key=lambda name: (name != "joint_states_merger", name))
COUNT = examples(700)  #: Number of messages for each node


def make_class(name):
    module = importlib.import_module(node_module(name))
    (kind,) = (
        kind
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Node) and kind.__module__ == module.__name__
    )
    return kind


def numbers(item):
    """Yield all numbers of a message but covariances, which may be unknown."""
    if isinstance(item, float):
        yield item
    elif hasattr(item, "get_fields_and_field_types"):
        for field in item.get_fields_and_field_types():
            if field not in ("covariance", "effort"):
                yield from numbers(getattr(item, field))
    elif not isinstance(item, (str, bytes, int)):
        for inner in item:
            yield from numbers(inner)


@pytest.mark.parametrize("name", representative(FED, every=len(FED)))
def test_no_message_ends_a_node_or_makes_it_command_what_is_not_finite(name, monkeypatch):
    sent = []
    publish = Publisher.publish

    def record(self, message):
        if self.topic_name.lstrip("/") in COMMANDS:
            is_packed = isinstance(message, bytes)
            sent.append(deserialize_message(message, self.msg_type) if is_packed else message)
        publish(self, message)

    monkeypatch.setattr(Publisher, "publish", record)
    with World(make_class(name), parameters=parameters_of(name)) as world:
        (node,) = world.nodes
        messages = RandomMessages(7, WORDS, world.stamp)
        inputs = [s for s in node.subscriptions if s.topic_name != "/clock"]
        moving = [s for s in inputs if s.topic_name.lstrip("/") not in STOPS]
        world.run(0.05)
        for k in range(COUNT):
            chosen = moving if 2 * k < COUNT and moving else inputs
            if not chosen:
                break
            subscription = chosen[k % len(chosen)]
            message = messages.make(subscription.msg_type)
            if subscription.raw:
                message = messages.damaged(serialize_message(message))
            deliver(subscription, message, round(1e9 * world.time))
            if k % 5 == 0:
                world.run(0.005)
        world.run(0.5)
        assert world.context.ok()
    assert all(map(math.isfinite, (value for message in sent for value in numbers(message))))
