"""The harness of the node tests serves callbacks as the executors of rclpy do."""

from rclpy.node import Node

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
