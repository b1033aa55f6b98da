import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from omniman_ros.core.errors import InputError
from omniman_ros.nodes import joint_state_reader
from omniman_ros.nodes.joint_state_reader import JointStateReader

NAMES = ("front_left", "front_right", "rear_left", "rear_right")
OTHER = ("rear_right", "front_left", "else", "rear_left", "front_right")
FIELDS = ("position", "velocity", "effort")


def message(k=0, names=NAMES, fields=FIELDS, frame=""):
    arrays = {
        field: [k + 10.0 * FIELDS.index(field) + 0.1 * i for i in range(len(names))]
        for field in fields
    }
    result = JointState(name=list(names), **arrays)
    result.header.stamp, result.header.frame_id = Time(sec=k, nanosec=7), frame
    return result


def check(reader, sent):
    """Assert that a message is read as it was sent."""
    read = reader.read(serialize_message(sent))
    assert read.stamp == (sent.header.stamp.sec, sent.header.stamp.nanosec)
    order = [sent.name.index(name) for name in NAMES]
    for field in FIELDS:
        values, result = getattr(sent, field), getattr(read, field)
        if len(values):
            np.testing.assert_array_equal(result, np.array(values)[order])
        else:
            assert result is None


@pytest.fixture
def deserialized(monkeypatch):
    """Count the messages that are deserialized."""
    seen = []
    whole = joint_state_reader.deserialized

    def counted(data, kind):
        seen.append(data)
        return whole(data, kind)

    monkeypatch.setattr(joint_state_reader, "deserialized", counted)
    return seen


@pytest.mark.parametrize("fields", [FIELDS, ("position",), ("velocity", "effort"), ()])
def test_only_the_first_of_messages_of_one_kind_is_deserialized(deserialized, fields):
    reader = JointStateReader(NAMES)
    for k in range(5):
        check(reader, message(k, fields=fields))
    assert len(deserialized) == 1


def test_messages_of_another_order_or_content_are_deserialized(deserialized):
    reader = JointStateReader(NAMES)
    variants = [
        message(1),
        message(2, OTHER),
        message(3, fields=("velocity",)),
        message(4, frame="a"),
        message(5, ("front_left", "front_right", "rear_right", "rear_left")),
        message(6, frame="b"),
    ]
    for variant in variants:
        check(reader, variant)
    assert len(deserialized) == len(variants)


def test_a_name_that_differs_in_a_letter_is_found():
    reader = JointStateReader(NAMES)
    check(reader, message())
    with pytest.raises(InputError, match="no rear_right"):
        reader.read(serialize_message(message(1, (*NAMES[:3], "rear_riGht"))))


@pytest.mark.parametrize("size", [0, 3, 40, -1])
def test_cut_messages_are_refused(size):
    reader = JointStateReader(NAMES)
    check(reader, message())
    with pytest.raises(InputError):
        reader.read(serialize_message(message(1))[:size])
