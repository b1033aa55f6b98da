"""Nodes on /clock: their timers, and their permits for time to go on."""

import math
import time

import pytest
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from omniman_ros.nodes.clock_follower import PERMITS_TOPIC
from omniman_ros.nodes.omniman_node import OmnimanNode
from test.nodes.harness import MATCH_TIMEOUT, World

PERIOD = 0.005  #: Step of /clock [s]


class FollowingNode(OmnimanNode):
    """A node that notes when its timer is called, and how far it says that it has come."""

    def __init__(self, lookahead=0.01, **options):
        self.lookahead = lookahead
        super().__init__("following", **options)
        self.calls, self.times, self.behind = [], [], 0.0
        self.every(0.02, lambda: self.calls.append(self.now()))
        self.follow_clock()

    @property
    def progress(self):
        return self.now() - self.behind

    def time_passed(self):
        self.times.append(self.now())


class Rig(World):
    """A following node, and a probe that publishes /clock and receives the permits."""

    def __init__(self, **options):
        super().__init__(lambda **given: FollowingNode(**options, **given))
        self.node = self.nodes[0]
        self.clock = self.publisher(Clock, "/clock", 10)
        self._permits = self.listen(Header, PERMITS_TOPIC)
        self.ticks = 0

    def tick(self, now):
        """Publish a time, and serve until it has been received."""
        self.ticks += 1
        message = Clock()
        message.clock.sec, message.clock.nanosec = int(now), round(now % 1 * 1e9)
        self.clock.publish(message)
        self._await(lambda: len(self.node.times) == self.ticks, "the time")

    @property
    def permits(self):
        self.serve()
        return [m.stamp.sec + 1e-9 * m.stamp.nanosec for m in self._permits]


@pytest.fixture
def rig():
    with Rig() as made:
        yield made


def test_timers_are_called_by_the_time_on_clock(rig):
    for k in range(1, 41):
        rig.tick(2000.0 + k * PERIOD)
    assert len(rig.node.calls) == pytest.approx(10, abs=1)
    assert rig.node.calls[-5:] == pytest.approx(
        [rig.node.calls[-1] - k * 0.02 for k in range(4, -1, -1)], abs=1e-6
    )


def test_each_time_is_permitted_with_the_lookahead_once_the_timers_were_called(rig):
    for k in range(1, 6):
        rig.tick(2000.0 + k * PERIOD)
    rig._await(lambda: len(rig.permits) == 5, "the permits")
    assert rig.permits == pytest.approx([2000.01 + k * PERIOD for k in range(1, 6)])
    assert {message.frame_id for message in rig._permits} == {"/following"}


def test_a_long_lookahead_needs_few_permits():
    with Rig(lookahead=0.04) as rig:
        for k in range(1, 41):
            rig.tick(2000.0 + k * PERIOD)
        rig._await(lambda: rig.permits and rig.permits[-1] > 2000.2, "the last permit")
        assert len(rig.permits) <= 11


def test_a_node_that_has_come_no_further_permits_nothing_until_it_has(rig):
    rig.tick(2000.0)
    rig.node.behind = 0.1
    rig.tick(2000.1)
    rig.node.behind = 0.02
    rig.node.report_progress()
    rig._await(lambda: len(rig.permits) == 2, "the permits")
    assert rig.permits == pytest.approx([2000.01, 2000.09])


def test_a_time_that_is_repeated_is_permitted_again(rig):
    rig.tick(2000.0)
    rig.tick(2000.0)
    rig._await(lambda: len(rig.permits) == 2, "the permits")
    assert rig.permits == pytest.approx([2000.01, 2000.01])


def test_time_that_begins_anew_is_permitted(rig):
    rig.tick(2000.0)
    rig.tick(1.0)
    rig._await(lambda: len(rig.permits) == 2, "the permits")
    assert rig.permits[1] == pytest.approx(1.01)


def test_nobody_waits_for_a_node_that_blocks_or_that_only_watches(rig):
    rig.tick(2000.0)
    with rig.node.clock_released():
        rig.tick(2000.1)
    rig.tick(2000.2)
    rig._await(lambda: len(rig.permits) == 3, "the permits")
    assert rig.permits == pytest.approx([2000.01, 0.0, 2000.21])
    with Rig(lookahead=math.inf) as watching:
        for k in range(10):
            watching.tick(2000.0 + k)
        assert watching.permits == []


def test_time_passes_while_a_callback_waits_and_its_timers_do_not_interrupt_it(rig):
    rig.tick(2000.0)
    calls = len(rig.node.calls)
    message = Clock()
    message.clock.sec = 2001
    rig.clock.publish(message)

    deadline = time.monotonic() + MATCH_TIMEOUT
    while rig.node.now() < 2000.9 and time.monotonic() < deadline:
        rig.node.poll_clock()  # the executor does not run meanwhile
    assert rig.node.now() == pytest.approx(2001.0)
    assert len(rig.node.calls) == calls
    rig.ticks += 1
    rig.tick(2001.005)
    assert len(rig.node.calls) == calls + 1
