"""Progress of motions and contacts as the recorder sees them."""

from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from omniman_ros.demo.recorder import Recorder
from omniman_ros.nodes.simulated_world import SimulatedWorldNode
from test.nodes.harness import World


def recorder_with(publishers=0, **options):
    """Return a recorder, and its callbacks by topic."""
    callbacks = {}

    def create_subscription(kind, topic, callback, qos):
        callbacks[topic] = callback
        return SimpleNamespace(get_publisher_count=lambda: publishers)

    node = SimpleNamespace(create_subscription=create_subscription)
    return Recorder(node, **options), callbacks


def test_in_a_world_each_contact_is_recorded_once():
    recorder, callbacks = recorder_with(1, contacts=True)
    touched = [
        DiagnosticStatus(name=name, level=DiagnosticStatus.WARN)
        for name in ("base_link, post", "tool0, anna")
    ]
    for status in (touched[:1], touched, touched[1:], []):
        callbacks["contacts"](DiagnosticArray(status=status))
    assert recorder.recording.contacts == ["base_link, post", "tool0, anna"]


def test_in_a_world_somebody_has_to_tell_contacts():
    assert "contacts" in recorder_with(0, contacts=True)[0].missing_topics
    assert "contacts" not in recorder_with(1, contacts=True)[0].missing_topics


def test_without_a_world_nothing_is_said_of_contacts():
    recorder, callbacks = recorder_with()
    assert "contacts" not in callbacks
    assert recorder.recording.contacts is None


def test_a_contact_of_the_real_world_is_recorded(tmp_path):
    """The robot, whose front is 0.5 m ahead, starts 1 cm in a post, which pushes it off."""
    pytest.importorskip("mujoco")
    scene = tmp_path / "scene.yaml"
    scene.write_text("posts: [{name: post, x: 0.59, y: 0.0, height: 0.3}]")
    given = {"scene": str(scene), "world.wheels": "ideal"}
    with World(SimulatedWorldNode, parameters=given) as world:
        recorder = Recorder(world.probe, contacts=True)
        world._await(lambda: "contacts" not in recorder.missing_topics, "the publisher")
        world._await(lambda: (world.run(0.02), recorder.recording.contacts)[1], "a contact")
        assert recorder.recording.contacts == ["base_link, post"]


def test_the_times_of_messages_are_those_of_their_senders():
    """Nothing is measured by when this process, on a clock that may not run yet, hears them."""
    recorder, callbacks = recorder_with()
    for topic, kind in (("odom", Odometry), ("wheel_commands", JointState)):
        for nanosec in (0, 10_000_000):
            message = kind()
            message.header.stamp = Time(sec=1, nanosec=nanosec)
            callbacks[topic](message)
    assert [row[0] for row in recorder.recording.odom] == pytest.approx([1.0, 1.01])
    assert recorder.recording.commands == pytest.approx([1.0, 1.01])
