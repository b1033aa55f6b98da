import contextlib

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from omniman_ros.core.errors import InputError
from omniman_ros.nodes import joint_state_reader
from omniman_ros.nodes.joint_state_reader import JointStateReader
from omniman_ros.nodes.serialized import deserialized
from test.nodes.harness import World

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


def unpadded(message):
    """Return a message without the padding that `serialize_message` adds at the end."""
    data = serialize_message(message)
    with contextlib.suppress(InputError):
        while deserialized(data[:-1], JointState) == message:
            data = data[:-1]
    return data


def padded(message):
    """Return a message with other bytes where they have no meaning."""
    data = bytearray(serialize_message(message))
    for k in range(4, len(data)):
        before, data[k] = data[k], data[k] ^ (0x10 + message.header.stamp.sec)
        with contextlib.suppress(InputError):
            if deserialized(bytes(data), JointState) == message:
                continue
        data[k] = before
    return bytes(data)


def check(reader, sent, serialized=serialize_message):
    """Assert that a message is read as it was sent."""
    read = reader.read(serialized(sent))
    assert read.stamp == (sent.header.stamp.sec, sent.header.stamp.nanosec)
    order = [sent.name.index(name) for name in NAMES]
    for field in FIELDS:
        values, result = getattr(sent, field), getattr(read, field)
        if len(values):
            np.testing.assert_array_equal(result, np.array(values)[order])
        else:
            assert result is None


@pytest.fixture
def whole_reads(monkeypatch):
    """Count the messages that are deserialized."""
    seen = []
    whole = joint_state_reader.deserialized

    def counted(data, kind):
        seen.append(data)
        return whole(data, kind)

    monkeypatch.setattr(joint_state_reader, "deserialized", counted)
    return seen


@pytest.mark.parametrize("serialized", [serialize_message, unpadded, padded])
@pytest.mark.parametrize(
    "fields", [FIELDS, ("position",), ("position", "velocity"), ("velocity", "effort"), ()]
)
def test_only_the_first_of_messages_of_one_kind_is_deserialized(whole_reads, fields, serialized):
    reader = JointStateReader(NAMES)
    for k in range(5):
        check(reader, message(k, fields=fields), serialized)
    assert len(whole_reads) == 1


@pytest.mark.parametrize("fields", [FIELDS, ("position", "velocity"), ("position",)])
def test_the_same_holds_for_what_the_middleware_delivers(whole_reads, fields):
    """In `wheel_states` all arrays are full, in `arm/joint_states` the last one is empty."""
    received, sent = [], [message(k, fields=fields) for k in range(5)]
    with World() as world:
        world.probe.create_subscription(JointState, "states", received.append, 9, raw=True)
        publisher = world.publisher(JointState, "states")
        for each in sent:
            publisher.publish(each)
        world.run_until(lambda: len(received) == len(sent), 1.0, "the messages")
    reader = JointStateReader(NAMES)
    for each, data in zip(sent, received, strict=True):
        check(reader, each, lambda sent, data=data: data)
    assert len(whole_reads) == 1


def test_data_in_another_encoding_are_deserialized_each_time(whole_reads):
    """XCDR2 aligns numbers otherwise; here only its mark is set, as the middleware has none."""
    reader = JointStateReader(NAMES)

    def marked(sent):
        return serialize_message(sent)[:2] + b"\x00\x01" + serialize_message(sent)[4:]

    for k in range(3):
        check(reader, message(k), marked)
    assert len(whole_reads) == 3


def test_messages_of_another_order_or_content_are_deserialized(whole_reads):
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
    assert len(whole_reads) == len(variants)


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
