"""Topics by which a source of motion learns whether it is followed."""

import pytest
from std_msgs.msg import Bool, String

from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.stop_interface import LATCHED, RELAY
from omniman_ros.nodes.stream_monitor_interface import REPETITION, StreamMonitorInterface
from test.nodes.harness import World


@pytest.fixture
def world():
    with World(lambda **options: OmnimanNode("source", **options)) as made:
        made.monitor = StreamMonitor(0.5, "path", ())
        made.updates = []
        made.interface = StreamMonitorInterface(
            made.nodes[0], made.monitor, lambda: made.updates.append(made.monitor.source)
        )
        yield made


def test_the_active_source_is_known_once_it_is_published(world):
    world.publisher(String, "active_source", LATCHED).publish(String(data="path"))
    world.run(0.02)
    assert world.updates == ["path"]


def test_an_old_report_that_is_delivered_again_changes_nothing(world):
    for name, sent in (("none", 10), ("path", 20), ("none", 10), ("path", 20), ("none", 30)):
        world.interface._on_source(String(data=name), sent)
    assert world.updates == ["none", "path", "path", "none"]


def test_a_source_whose_clock_was_set_back_is_believed_after_a_while(world):
    world.interface._on_source(String(data="path"), 20)
    world.run(REPETITION + 0.1)
    world.interface._on_source(String(data="none"), 10)
    assert world.updates == ["path", "none"]


def test_a_press_is_relayed_once_to_the_nodes_that_move_something(world):
    relayed = world.listen(String, RELAY)
    button = world.publisher(Bool, "emergency_stop")
    for pressed in (True, True, False, True):
        button.publish(Bool(data=pressed))
        world.run(0.02)
    assert [message.data for message in relayed] == ["emergency_stop", "emergency_stop"]
