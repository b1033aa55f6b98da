"""The harness of the node tests serves callbacks as the executors of rclpy do."""

from functools import partial

from rclpy.node import Node
from std_msgs.msg import String

from omniman_ros.nodes.stop_interface import LATCHED
from test.nodes.harness import PERIOD, World


class Pair(Node):
    """Two timers that are due at the same time; each cancels the other."""

    def __init__(self, **options):
        super().__init__("pair", **options)
        self.called = []
        self.pair = [
            self.create_timer(PERIOD, lambda: self.call(0)),
            self.create_timer(PERIOD, lambda: self.call(1)),
        ]

    def call(self, index):
        self.called.append(index)
        self.pair[1 - index].cancel()


def test_timer_that_was_cancelled_in_the_same_pass_is_not_called():
    with World(Pair) as world:
        world.run(3 * PERIOD)
        called = world.nodes[0].called
        assert called and len(set(called)) == 1


TOPICS = [f"state_{index}" for index in range(20)]


class Source(Node):
    """Publishes one latched message on each topic as soon as it exists."""

    def __init__(self, **options):
        super().__init__("source", **options)
        for topic in TOPICS:
            self.create_publisher(String, topic, LATCHED).publish(String(data=topic))


class Reader(Node):
    """Subscribes to the latched messages that have already been published."""

    def __init__(self, **options):
        super().__init__("reader", **options)
        self.received = []
        for topic in TOPICS:
            self.create_subscription(String, topic, partial(self.note, topic), LATCHED)

    def note(self, topic, message):
        self.received.append(topic)


def test_latched_messages_of_the_nodes_are_there_in_the_first_pass():
    with World(Source, Reader) as world:
        world.serve()
        assert sorted(world.nodes[1].received) == sorted(TOPICS)
