import pytest

pytest.importorskip("rosbags", reason="rosbags is not installed (extra 'record')")

from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from omniman_ros.recording.definitions import MessageDefinitions
from omniman_ros.recording.reader import BagReader
from omniman_ros.recording.topic_metadata import TopicMetadata
from omniman_ros.recording.writer import BagWriter

TYPE = "sensor_msgs/msg/JointState"


@pytest.mark.parametrize("name", ["constraint", "constraint_1", "constraint_10000"])
def test_what_the_middleware_serializes_is_read_with_and_without_alignment_at_its_end(
    tmp_path, name
):
    sent = JointState(name=[name, name + "_total"], position=[1.0, 2.0], velocity=[3.0, 4.0])
    data = serialize_message(sent)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(TopicMetadata("/errors", TYPE, *MessageDefinitions().lookup(TYPE)))
        assert writer.put("/errors", 1_000_000_000, data)
    with BagReader(tmp_path / "bag") as bag:
        [(topic, time, message)] = bag.messages(["/errors"])
    assert (topic, time, message.name) == ("/errors", 1.0, sent.name)
    assert (list(message.position), list(message.velocity)) == ([1.0, 2.0], [3.0, 4.0])
    assert len(message.effort) == 0
